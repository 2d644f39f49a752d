"""Settings: frozen dataclasses whose annotations define which values they accept.

The range of a field is part of its type, and is checked in one place::

    @dataclass(frozen=True)
    class RangeNoise(Settings):
        intrinsic: NonNegative = 0.0015
        exponent: Annotated[float, Bounds(at_least=1, at_most=3)] = 2.0

Numbers are finite, integers are integers, nested settings are of their class, and a `Literal` is
one of its choices. Relations between fields are checked by a class's own `__post_init__`, which
calls that of `Settings` first. `settings_to_dict` and `settings_from_dict` write and read them as
JSON values, so that a job or a summary records what it ran with.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import cache
from numbers import Integral, Real
from types import NoneType, UnionType
from typing import Annotated, Any, Literal, TypeVar, Union, get_args, get_origin, get_type_hints

SettingsT = TypeVar("SettingsT")


@dataclass(frozen=True)
class Bounds:
    """Interval of the numbers that a field accepts; a bound that is left out is infinite."""

    at_least: float = -math.inf
    above: float = -math.inf
    at_most: float = math.inf
    below: float = math.inf

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
        for name, (accepts, expected) in _checks(kind).items():
            value = getattr(self, name)
            if not accepts(value):
                raise ValueError(f"{kind.__name__}.{name} must be {expected}, got {value!r}")


Check = tuple[Callable[[Any], bool], str]
"""Whether a value is accepted, and what is expected, in words."""


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
        return (lambda value: value in parts), f"one of {', '.join(map(repr, parts))}"
    if origin in (Union, UnionType):
        checks = [_check(part, within) for part in parts]
        return (
            lambda value: any(accepts(value) for accepts, _ in checks),
            " or ".join(expected for _, expected in checks),
        )
    if origin is tuple:
        return _tuple_check(parts, within)
    if hint in (int, float):
        return _number_check(hint, within)
    if hint is NoneType:
        return (lambda value: value is None), "None"
    if hint in (bool, str) or is_dataclass(hint):
        return (lambda value: isinstance(value, hint)), hint.__name__
    return (lambda value: True), "any value"


def _number_check(hint: type, within: Bounds | None) -> Check:
    is_integer, bounds = hint is int, within or Bounds()
    kind: type = Integral if is_integer else Real

    def accepts(value: Any) -> bool:
        is_number = isinstance(value, kind) and not isinstance(value, bool)
        return is_number and math.isfinite(value) and value in bounds

    return accepts, f"{'an integer' if is_integer else 'a finite number'} {bounds}".rstrip()


def _tuple_check(parts: tuple[Any, ...], within: Bounds | None) -> Check:
    if parts[-1] is Ellipsis:
        accepts, expected = _check(parts[0], within)
        return (
            lambda value: isinstance(value, tuple) and all(map(accepts, value)),
            f"a tuple, each {expected}",
        )
    checks = [_check(part, within) for part in parts]
    return (
        lambda value: (
            isinstance(value, tuple)
            and len(value) == len(checks)
            and all(accepts(one) for (accepts, _), one in zip(checks, value, strict=True))
        ),
        f"({', '.join(expected for _, expected in checks)})",
    )


def settings_to_dict(settings: Any) -> dict[str, Any]:
    """JSON values of settings; nested settings become nested dictionaries."""
    return asdict(settings)


def settings_from_dict(values: dict[str, Any], target_type: type[SettingsT]) -> SettingsT:
    """The settings that `settings_to_dict` wrote.

    Parameters
    ----------
    values : dict
        JSON values.
    target_type : type
        The settings' class, such as `PlanarSettings`.

    Raises
    ------
    ValueError
        If a name is unknown or a value is not accepted.
    """
    assert is_dataclass(target_type)
    field_names = {field.name for field in fields(target_type)}
    if unknown := set(values) - field_names:
        raise ValueError(f"unknown settings {sorted(unknown)}; known are {sorted(field_names)}")
    hints = get_type_hints(target_type)
    try:
        return target_type(
            **{name: _from_json(value, hints[name]) for name, value in values.items()}
        )
    except TypeError as error:
        raise ValueError(f"settings: {error}") from error


def _from_json(value: Any, target_type: Any) -> Any:
    """One value; nested settings are dictionaries in JSON, and tuples are lists."""
    if is_dataclass(target_type) and isinstance(target_type, type) and isinstance(value, dict):
        return settings_from_dict(value, target_type)
    return tuple(value) if isinstance(value, list) else value
