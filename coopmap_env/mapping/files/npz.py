"""NumPy's archive of arrays: the whole map, bit for bit, planar and 3-D."""

from __future__ import annotations

import io
import math
import os
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import read_zip_members
from coopmap_env.core.files import brief, write_atomically
from coopmap_env.mapping.files.base import (
    MapFileError,
    errors_naming,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.occupancy_map import OccupancyMap

FORMAT = "coopmap map 1"
"""Entry ``format`` of the archive."""
TEXTS = ("format", "settings")
MAX_TEXT_BYTES = 1 << 16
ARRAYS = ("levels", "sampled", "cells", "precisions", "vectors")
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def save_npz(map_: OccupancyMap, path: str | os.PathLike[str]) -> None:
    """Write a map; surface estimates as those of the hit cells, in information form."""
    cells, precisions, vectors = map_.information_form()
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        format=np.array(FORMAT),
        settings=np.array(settings_to_json(map_)),
        levels=map_.log_odds_fixed,
        sampled=map_.sampled_mask,
        cells=cells,
        precisions=precisions,
        vectors=vectors,
    )
    write_atomically(path, buffer.getvalue())


def load_npz(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read a map.

    Raises
    ------
    MapFileError
        If the file is missing, broken or too large, or its arrays do not make a map.
    """
    contents = read_zip_members(path, [f"{name}.npy" for name in (*TEXTS, *ARRAYS)], MapFileError)
    entries = {
        name.removesuffix(".npy"): _parse_array(path, name, content)
        for name, content in contents.items()
    }
    format_, settings = (_text(path, name, entries[name]) for name in TEXTS)
    if format_ != FORMAT:
        raise MapFileError(f"{path} is of format {brief(format_)}, not {FORMAT!r}")
    with errors_naming(path):
        map_ = map_from_settings(settings, path)
        map_.set_state(*(entries[name] for name in ARRAYS))
    return map_


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
