"""NumPy's archive of arrays: the whole map, bit for bit, planar and 3-D."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from coopmap_env.core.array_files import read_arrays, read_texts, write_arrays
from coopmap_env.core.files import brief
from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.files.base import (
    MapFileError,
    errors_naming,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.occupancy_map import OccupancyMap

TEXTS = ("format", "settings")
OCCUPANCY = ("levels", "sampled", "cells")
EQ_4_SUMS = ("precisions", "vectors")
MEAN_SUMS = ("counts", "sums", "noise", "scatter", "shared")
FORMATS = {"coopmap map 1": EQ_4_SUMS, "coopmap map 2": MEAN_SUMS}
"""Entry ``format`` of the archive, and its names of the `SurfaceArrays`, without empty ones."""


def save_npz(map_: OccupancyMap, path: str | os.PathLike[str]) -> None:
    """Write a map; surface estimates as the sums of the hit cells."""
    cells, sums = map_.hit_cell_sums()
    format_ = "coopmap map 2" if map_.model.surface_fusion == "mean" else "coopmap map 1"
    arrays: dict[str, Any] = {
        "format": np.array(format_),
        "settings": np.array(settings_to_json(map_)),
        "levels": map_.log_odds_fixed,
        "sampled": map_.sampled_mask,
        "cells": cells,
        **dict(zip(FORMATS[format_], sums, strict=False)),  # Eq. 4 has two sums only
    }
    write_arrays(path, arrays)


def load_npz(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read a map.

    Raises
    ------
    MapFileError
        If the file is missing, broken or too large, or its arrays do not make a map.
    """
    format_, settings = read_texts(path, TEXTS, MapFileError)
    if format_ not in FORMATS:
        raise MapFileError(
            f"{path} is of format {brief(format_)}, not {' or '.join(map(repr, FORMATS))}"
        )
    names = FORMATS[format_]
    entries = read_arrays(path, (*OCCUPANCY, *names), MapFileError)
    with errors_naming(path):
        map_ = map_from_settings(settings, path)
        arrays = [entries[name] for name in names]
        sums = SurfaceArrays.of_eq_4(*arrays) if names == EQ_4_SUMS else SurfaceArrays(*arrays)
        map_.set_state(entries["levels"], entries["sampled"], entries["cells"], sums)
    return map_
