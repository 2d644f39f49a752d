"""NumPy's archive of arrays: the whole map, bit for bit, planar and 3-D."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import read_zip_members
from coopmap_env.core.files import brief, write_atomically
from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.files.base import (
    MapFileError,
    errors_naming,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.occupancy_map import OccupancyMap

TEXTS = ("format", "settings")
MAX_TEXT_BYTES = 1 << 16
OCCUPANCY = ("levels", "sampled", "cells")
EQ_4_SUMS = ("precisions", "vectors")
MEAN_SUMS = ("counts", "sums", "noise", "scatter", "shared")
FORMATS = {"coopmap map 1": EQ_4_SUMS, "coopmap map 2": MEAN_SUMS}
"""Entry ``format`` of the archive, and its names of the `SurfaceArrays`, without empty ones."""
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def save_npz(map_: OccupancyMap, path: str | os.PathLike[str]) -> None:
    """Write a map; surface estimates as the sums of the hit cells."""
    cells, sums = map_.hit_cell_sums()
    format_ = "coopmap map 2" if map_.model.surface_fusion == "mean" else "coopmap map 1"
    buffer = io.BytesIO()
    arrays: dict[str, Any] = {
        "format": np.array(format_),
        "settings": np.array(settings_to_json(map_)),
        "levels": map_.log_odds_fixed,
        "sampled": map_.sampled_mask,
        "cells": cells,
        **dict(zip(FORMATS[format_], sums, strict=False)),  # Eq. 4 has two sums only
    }
    np.savez_compressed(buffer, **arrays)
    write_atomically(path, buffer.getvalue())


def load_npz(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read a map.

    Raises
    ------
    MapFileError
        If the file is missing, broken or too large, or its arrays do not make a map.
    """
    texts = _read_arrays(path, TEXTS)
    format_, settings = (_text(path, name, texts[name]) for name in TEXTS)
    if format_ not in FORMATS:
        raise MapFileError(
            f"{path} is of format {brief(format_)}, not {' or '.join(map(repr, FORMATS))}"
        )
    names = FORMATS[format_]
    entries = _read_arrays(path, (*OCCUPANCY, *names))
    with errors_naming(path):
        map_ = map_from_settings(settings, path)
        arrays = [entries[name] for name in names]
        sums = SurfaceArrays.of_eq_4(*arrays) if names == EQ_4_SUMS else SurfaceArrays(*arrays)
        map_.set_state(entries["levels"], entries["sampled"], entries["cells"], sums)
    return map_


def _read_arrays(path: str | os.PathLike[str], names: Sequence[str]) -> dict[str, NDArray[Any]]:
    """Members of the archive by their names without suffix."""
    contents = read_zip_members(path, [f"{name}.npy" for name in names], MapFileError)
    return {
        name.removesuffix(".npy"): _parse_array(path, name, content)
        for name, content in contents.items()
    }


def _parse_array(path: str | os.PathLike[str], name: str, content: bytes) -> NDArray[Any]:
    """The array of an NPY file, whose header must state exactly the bytes that follow it."""
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        shape, column_major, dtype = _HEADER_READERS[version](file)
        data = content[file.tell() :]
        if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(data):
            raise ValueError(f"{len(data)} bytes are no {brief(dtype)} of shape {brief(shape)}")
        return np.ndarray(shape, dtype, data, order="F" if column_major else "C")
    except Exception as error:  # a header is Python's text, and is read with what reads Python
        raise MapFileError(f"{path}: {name} is broken: {error!r:.500}") from error


def _text(path: str | os.PathLike[str], name: str, entry: NDArray[Any]) -> str:
    try:
        if entry.ndim or entry.dtype.kind != "U" or entry.nbytes > MAX_TEXT_BYTES:
            raise ValueError(f"expected a text of at most {MAX_TEXT_BYTES} bytes")
        return str(entry)
    except ValueError as error:  # also of a number that is no character
        raise MapFileError(f"{path}: {name}.npy is broken: {error}") from error
