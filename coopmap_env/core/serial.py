"""Settings as JSON values and back, so that a job or a summary says what it ran with."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

Settings = TypeVar("Settings")


def settings_to_dict(settings: Any) -> dict[str, Any]:
    """Nested JSON values of the settings of any world."""
    return asdict(settings)


def settings_from_dict(values: dict[str, Any], kind: type[Settings]) -> Settings:
    """The settings that `settings_to_dict` wrote.

    Parameters
    ----------
    values : dict
        JSON values.
    kind : type
        The settings' class, such as `PlanarSettings`.

    Raises
    ------
    ValueError
        If a name is unknown or a value is not accepted.
    """
    assert is_dataclass(kind)
    known = {field.name for field in fields(kind)}
    if unknown := set(values) - known:
        raise ValueError(f"unknown settings {sorted(unknown)}; known are {sorted(known)}")
    hints = get_type_hints(kind)
    try:
        return kind(**{name: _value(value, hints[name]) for name, value in values.items()})
    except TypeError as error:
        raise ValueError(f"settings: {error}") from error


def _value(value: Any, kind: Any) -> Any:
    """One value; nested settings are dictionaries in JSON, and tuples are lists."""
    if is_dataclass(kind) and isinstance(kind, type) and isinstance(value, dict):
        return settings_from_dict(value, kind)
    return tuple(value) if isinstance(value, list) else value
