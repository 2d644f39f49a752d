"""Common to all map files: errors that name the file, and a map's settings as JSON."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from coopmap_env.core.files import FileError
from coopmap_env.mapping.beam import BeamModel
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import LogOddsRange
from coopmap_env.mapping.occupancy_map import OccupancyMap


class MapFileError(FileError):
    """A map file that is missing, broken, truncated or of another format; the message names it."""


@contextmanager
def errors_naming(path: str | os.PathLike[str]) -> Iterator[None]:
    """Turn the errors of a block that reads a file into `MapFileError` with the file's name."""
    try:
        yield
    except MapFileError:
        raise
    except MemoryError as error:
        raise MapFileError(f"{path}: there is not enough memory for it") from error
    except ValueError as error:
        raise MapFileError(f"{path}: {error}") from error


def settings_to_json(map_: OccupancyMap) -> str:
    """Grid, beam model and clamp in one line of JSON, whose floats are read back exactly."""
    settings = {
        "grid": asdict(map_.grid),
        "beam": asdict(map_.model),
        "max_probability": map_.log_odds_range.max_probability,
    }
    return json.dumps(settings)


def map_from_settings(text: str, path: str | os.PathLike[str]) -> OccupancyMap:
    """A new map of the settings that `settings_to_json` wrote.

    Raises
    ------
    MapFileError
        If the text is not of that form.
    MemoryError
        If there is not enough memory for such a map.
    """
    try:
        settings: Any = json.loads(text)
        grid, beam = settings["grid"], settings["beam"]
        return OccupancyMap(
            VoxelGrid(tuple(grid["shape"]), grid["resolution"], tuple(grid["origin"])),
            BeamModel(**beam),
            LogOddsRange(settings["max_probability"]),
        )
    except (LookupError, ArithmeticError, RecursionError) as error:
        raise MapFileError(f"{path}: the map's settings are broken: {error!r:.500}") from error
    except (ValueError, TypeError) as error:
        raise MapFileError(f"{path}: the map's settings are broken: {error!s:.500}") from error
