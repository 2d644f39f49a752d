"""NumPy's archive of arrays: the whole map, bit for bit, planar and 3-D."""

from __future__ import annotations

import io
import os
import zipfile
import zlib

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import read_bytes, write_atomically
from coopmap_env.mapping.files.base import (
    MapFileError,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.occupancy_map import OccupancyMap

FORMAT = "coopmap map 1"
"""Entry ``format`` of the archive."""
ARRAYS = ("levels", "sampled", "cells", "precisions", "vectors")


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
        If the file is missing, broken, or its arrays do not make a map.
    """
    entries = _read(path)
    if str(entries["format"]) != FORMAT:
        raise MapFileError(f"{path} is of format {str(entries['format'])!r}, not {FORMAT!r}")
    map_ = map_from_settings(str(entries["settings"]), path)
    try:
        map_.set_state(*(entries[name] for name in ARRAYS))
    except ValueError as error:
        raise MapFileError(f"{path}: {error}") from error
    return map_


def _read(path: str | os.PathLike[str]) -> dict[str, NDArray[np.generic]]:
    try:
        with np.load(io.BytesIO(read_bytes(path, MapFileError)), allow_pickle=False) as archive:
            return {name: archive[name] for name in ("format", "settings", *ARRAYS)}
    except MapFileError:
        raise
    except KeyError as error:
        raise MapFileError(f"{path} is no map: {error}") from error
    except (OSError, ValueError, TypeError, EOFError, zipfile.BadZipFile, zlib.error) as error:
        raise MapFileError(f"{path} is broken or no NPZ file: {error}") from error
