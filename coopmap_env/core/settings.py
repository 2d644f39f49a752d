"""Settings: frozen dataclasses whose annotations define which values they accept.

The range of a field is part of its type, and is checked in one place::

    @dataclass(frozen=True)
    class RangeNoise(Settings):
        intrinsic: NonNegative = 0.0015
        exponent: Annotated[float, Bounds(at_least=1, at_most=3)] = 2.0

Numbers are finite, integers have at most 64 bits, nested settings are of their class,
and a `Literal` is one of its choices. What is accepted is kept as Python's own `int`, `float`,
`bool` or `str`, also where a numpy scalar is given: JSON and kernels know no other. Relations
between fields are checked by a class's own `__post_init__`, which calls that of `Settings` first.
`settings_to_dict` and `settings_from_dict` write and read them as JSON values, so that a job or a
summary records what it ran with.
"""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np

from coopmap_env.core.files import brief

SettingsT = TypeVar("SettingsT")
MAX_NESTED_LISTS = 4
"""Levels of lists in JSON that become tuples: more than any field has."""
SMALLEST, LARGEST = 1e-30, 1e30
"""Sizes of the numbers that are accepted besides 0: their squares and ratios stay finite."""
LARGEST_INTEGER = 2**63 - 1
"""Arrays and kernels have 64 bits."""


@dataclass(frozen=True)
class Bounds:
    """Interval of the numbers that a field accepts; a bound that is left out is infinite."""

    at_least: float = -math.inf
    above: float = -math.inf
    at_most: float = math.inf
    below: float = math.inf
    smallest: float = SMALLEST
    """Smallest size of a number that is not 0: a smaller one would take too much time or memory."""
    largest: float = LARGEST
    """Largest size of a number, for the same reason."""

    def __contains__(self, value: float) -> bool:
        return self.at_least <= value <= self.at_most and self.above < value < self.below

    def __str__(self) -> str:
        bounds = (
            (">", self.above),
            (">=", self.at_least),
            ("<", self.below),
            ("<=", self.at_most),
        )
        return " and ".join(f"{sign} {bound:g}" for sign, bound in bounds if math.isfinite(bound))


Positive = Annotated[float, Bounds(above=0)]
NonNegative = Annotated[float, Bounds(at_least=0)]
UnitInterval = Annotated[float, Bounds(at_least=0, at_most=1)]
OpenUnitInterval = Annotated[float, Bounds(above=0, below=1)]
PositiveInt = Annotated[int, Bounds(at_least=1)]
NonNegativeInt = Annotated[int, Bounds(at_least=0)]


@dataclass(frozen=True)
class Settings:
    """Base of all settings; checks every field against its annotation.

    Raises
    ------
    ValueError
        With the class, the field, what it accepts and the value.
    """

    def __post_init__(self) -> None:
        kind: Any = type(self)
        for name, check in _checks(kind).items():
            plain = _checked(f"{kind.__name__}.{name}", getattr(self, name), check)
            object.__setattr__(self, name, plain)


class _NotAcceptedError(Exception):
    """A value that a field does not accept; its text adds to what is expected, if need be."""


Check = tuple[Callable[[Any], Any], str]
"""What makes a value what is kept, or raises `_NotAcceptedError`; what is expected, in words."""


def _checked(name: str, value: Any, check: Check) -> Any:
    convert, expected = check
    try:
        return convert(value)
    except _NotAcceptedError as error:
        raise ValueError(f"{name} must be {expected}{error}, got {brief(value)}") from None


def checked_value(name: str, value: Any, hint: Any) -> Any:
    """An argument that is no field of settings, checked as one with this annotation would be.

    Raises
    ------
    ValueError
        With the name, what is accepted and the value.
    """
    return _checked(name, value, _check(hint))


@cache
def _checks(kind: Any) -> dict[str, Check]:
    hints = get_type_hints(kind, include_extras=True)
    return {field.name: _check(hints[field.name]) for field in fields(kind)}


def _check(hint: Any, within: Bounds | None = None) -> Check:
    origin, parts = get_origin(hint), get_args(hint)
    if origin is Annotated:
        ranges = [part for part in parts[1:] if isinstance(part, Bounds)]
        return _check(parts[0], ranges[0] if ranges else within)
    if origin is Literal:
        return _choice_check(parts)
    if origin in (Union, UnionType):
        return _union_check([_check(part, within) for part in parts])
    if origin is tuple:
        return _tuple_check(parts, within)
    if hint is int:
        return _integer_check(within or Bounds())
    if hint is float:
        return _float_check(within or Bounds())
    if hint is bool:
        return (lambda value: bool(_require_type(value, bool, np.bool_))), "bool"
    if hint is str:
        return (lambda value: str.__str__(_require_type(value, str))), "str"
    if hint is NoneType:
        return (lambda value: _require_type(value, NoneType)), "None"
    if isinstance(hint, type) and is_dataclass(hint):
        return (lambda value: _require_type(value, hint)), hint.__name__
    return (lambda value: value), "any value"


def _require(accepted: bool, expected: str = "") -> None:
    if not accepted:
        raise _NotAcceptedError(expected)


def _require_type(value: Any, *kinds: type) -> Any:
    _require(issubclass(type(value), kinds))  # `isinstance` would ask the value for its class
    return value


def _integer_check(bounds: Bounds) -> Check:
    largest = int(min(bounds.largest, LARGEST_INTEGER))

    def convert(value: Any) -> int:
        number = _to_number(value, Integral, lambda given: int(operator.index(given)))
        _require(number in bounds)
        _require(abs(number) <= largest, f" of at most {largest:,}")
        return number

    return convert, f"an integer {bounds}".rstrip()


def _float_check(bounds: Bounds) -> Check:
    smallest, largest = bounds.smallest, bounds.largest
    sizes = f" of a size from {smallest:g} to {largest:g}"

    def convert(value: Any) -> float:
        number = _to_number(value, Real, float)
        _require(math.isfinite(number) and number in bounds)
        _require(number == 0 or smallest <= abs(number) <= largest, sizes)
        return number

    return convert, f"a finite number {bounds}".rstrip()


def _to_number(value: Any, kind: type, convert: Callable[[Any], Any]) -> Any:
    _require(not isinstance(value, bool))
    try:
        return convert(_require_type(value, kind))
    except Exception:  # 10**400 as a float; `numpy.timedelta64`, which calls itself an integer
        raise _NotAcceptedError from None


def _choice_check(choices: tuple[Any, ...]) -> Check:
    def convert(value: Any) -> Any:
        for choice in choices:
            if issubclass(type(value), type(choice)) and _is_equal(value, choice):
                return choice
        raise _NotAcceptedError

    return convert, f"one of {', '.join(map(repr, choices))}"


def _is_equal(value: Any, choice: Any) -> bool:
    try:
        return bool(value == choice)
    except Exception:  # an odd subclass that cannot be compared
        return False


def _union_check(checks: list[Check]) -> Check:
    def convert(value: Any) -> Any:
        for convert_part, _ in checks:
            try:
                return convert_part(value)
            except _NotAcceptedError:
                continue
        raise _NotAcceptedError

    return convert, " or ".join(expected for _, expected in checks)


def _tuple_check(parts: tuple[Any, ...], within: Bounds | None) -> Check:
    if parts[-1] is Ellipsis:
        convert_one, expected = _check(parts[0], within)
        return (
            lambda value: tuple(map(convert_one, _require_type(value, tuple))),
            f"a tuple, each {expected}",
        )
    checks = [_check(part, within) for part in parts]

    def convert(value: Any) -> tuple[Any, ...]:
        _require(len(_require_type(value, tuple)) == len(checks))
        return tuple(convert_one(one) for (convert_one, _), one in zip(checks, value, strict=True))

    return convert, f"({', '.join(expected for _, expected in checks)})"


def settings_to_dict(settings: Any) -> dict[str, Any]:
    """JSON values of settings; nested settings become nested dictionaries."""
    return asdict(settings)


def settings_from_dict(values: Mapping[str, Any], target_type: type[SettingsT]) -> SettingsT:
    """The settings that `settings_to_dict` wrote.

    Parameters
    ----------
    values : mapping
        JSON values.
    target_type : type
        The settings' class, such as `PlanarSettings`.

    Raises
    ------
    ValueError
        With the class and what it has, if `values` is no mapping, a name is unknown or missing, or
        a value is not accepted.
    """
    assert is_dataclass(target_type)
    kind, field_names = target_type.__name__, {field.name for field in fields(target_type)}
    if not isinstance(values, Mapping):
        raise ValueError(f"{kind} must be a mapping of {sorted(field_names)}, got {brief(values)}")
    if unknown := [name for name in values if name not in field_names]:
        raise ValueError(
            f"unknown settings {brief(unknown)}; known are {sorted(field_names)} of {kind}"
        )
    hints = get_type_hints(target_type)
    given = {name: _from_json(value, hints[name]) for name, value in values.items()}
    try:
        return target_type(**given)
    except TypeError as error:
        raise ValueError(f"{kind}: {error}") from error


def _from_json(value: Any, hint: Any) -> Any:
    """One value; nested settings are dictionaries in JSON, and tuples are lists."""
    if isinstance(value, Mapping):
        parts = (hint, *get_args(hint))
        nested = [part for part in parts if isinstance(part, type) and is_dataclass(part)]
        return settings_from_dict(value, nested[0]) if len(nested) == 1 else value
    return _to_tuple(value, MAX_NESTED_LISTS)


def _to_tuple(value: Any, levels: int) -> Any:
    if not isinstance(value, list) or not levels:
        return value
    return tuple(_to_tuple(one, levels - 1) for one in value)
