"""Settings as JSON values and back, so that a job or a summary says what it ran with."""

from __future__ import annotations

from dataclasses import asdict, fields
from typing import Any

from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.information import RatingSettings
from coopmap_env.mapping import BeamModel, LogOddsRange
from coopmap_env.sensing import PlanarCamera, RangeNoise

_PARTS: dict[str, Any] = {
    "camera": PlanarCamera,
    "noise": RangeNoise,
    "beam": BeamModel,
    "log_odds_range": LogOddsRange,
    "rating": RatingSettings,
}


def settings_to_dict(settings: PlanarSettings) -> dict[str, Any]:
    """Nested JSON values."""
    return asdict(settings)


def settings_from_dict(values: dict[str, Any]) -> PlanarSettings:
    """The settings that `settings_to_dict` wrote.

    Raises
    ------
    ValueError
        If a name is unknown or a value is not accepted.
    """
    known = {field.name for field in fields(PlanarSettings)}
    if unknown := set(values) - known:
        raise ValueError(f"unknown settings {sorted(unknown)}; known are {sorted(known)}")
    try:
        parts = {
            name: _PARTS[name](**value) if name in _PARTS else value
            for name, value in values.items()
        }
    except TypeError as error:
        raise ValueError(f"settings: {error}") from error
    return PlanarSettings(**parts)
