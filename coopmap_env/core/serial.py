"""Settings as JSON values and back, so that a job or a summary records what it ran with."""

from __future__ import annotations

from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, get_type_hints

SettingsT = TypeVar("SettingsT")


def settings_to_dict(settings: Any) -> dict[str, Any]:
    """Nested JSON values of the settings of any world."""
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
