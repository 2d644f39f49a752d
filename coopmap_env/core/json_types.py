"""Whether a JSON value has the form that annotations describe."""

from __future__ import annotations

import math
import types
from dataclasses import MISSING, fields, is_dataclass
from typing import Any, Union, get_args, get_origin, get_type_hints, is_typeddict

from coopmap_env.core.settings import LARGEST_INTEGER


def has_type(value: Any, annotation: Any) -> bool:
    """Whether a JSON value is as an annotation says.

    Parameters
    ----------
    value : object
        From `json.loads`.
    annotation : type
        int of at most 64 bits, float (NaN and integers included, infinity not), bool, str, None,
        ``list[T]``, ``dict[str, T]``, a union, a TypedDict, or a dataclass as `dataclasses.asdict`
        turns it into a dictionary. Other keys than those of a TypedDict or a dataclass are not
        accepted.
    """
    origin, arguments = get_origin(annotation), get_args(annotation)
    if origin in (Union, types.UnionType):
        return any(has_type(value, argument) for argument in arguments)
    if origin is list:
        return isinstance(value, list) and all(has_type(item, arguments[0]) for item in value)
    if origin is dict:
        return isinstance(value, dict) and all(
            has_type(item, arguments[1]) for item in value.values()
        )
    if is_typeddict(annotation):
        return _has_fields(value, annotation, annotation.__required_keys__)
    if is_dataclass(annotation):
        required = {
            field.name
            for field in fields(annotation)
            if field.default is MISSING and field.default_factory is MISSING
        }
        return _has_fields(value, annotation, required)
    return _has_plain_type(value, annotation)


def _has_fields(value: Any, annotation: Any, required: frozenset[str] | set[str]) -> bool:
    hints = get_type_hints(annotation)
    return (
        isinstance(value, dict)
        and required <= set(value) <= set(hints)
        and all(has_type(item, hints[name]) for name, item in value.items())
    )


def _has_plain_type(value: Any, annotation: Any) -> bool:
    is_integer = type(value) is int and abs(value) <= LARGEST_INTEGER  # a bool is no number here
    if annotation is float:
        return is_integer or (type(value) is float and not math.isinf(value))
    if annotation is int:
        return is_integer
    return type(value) is annotation or (value is None and annotation is types.NoneType)
