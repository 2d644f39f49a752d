"""Checks of constructor arguments: the message names the argument, the value and the choices."""

import operator
from dataclasses import fields
from typing import Any

import numpy as np

from coopmap_env.core.files import brief


def check_choice(name: str, value: Any, choices: tuple[Any, ...]) -> None:
    """ValueError unless the value is one of the choices."""
    if value not in choices:
        raise ValueError(f"{name} must be one of {', '.join(map(repr, choices))}, got {value!r}")


def check_count(name: str, value: Any, at_least: int = 1) -> int:
    """The value as an int; ValueError unless it is an integer of at least so much."""
    try:
        number = operator.index(value)
    except Exception:  # a TypeError, or what an object's `__index__` raises
        number = at_least - 1
    if number < at_least or isinstance(value, bool | np.bool_):
        raise ValueError(f"{name} must be an integer of at least {at_least}, got {brief(value)}")
    return number


def check_array_shapes(owner: Any, shapes: list[tuple[int, ...]]) -> None:
    """ValueError unless the arrays of a dataclass have these shapes, in the order of its fields."""
    found = [getattr(owner, field.name).shape for field in fields(owner)]
    if found != shapes:
        raise ValueError(f"{type(owner).__name__} needs arrays of shapes {shapes}, got {found}")
