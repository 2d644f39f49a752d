"""Write what robots have mapped in the form of ROS map_server (see `map_server`).

Three gray values, as map_saver writes them: occupied 0, free 254, unknown 205. With a
``free_thresh`` of 0.196 the 205 of unknown (p = 50/255 = 0.1961) is just not free.
"""

import math
import os
import uuid
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from ...extras import require
from .world import check_resolution

OCCUPIED_THRESH = 0.65
"""Default of map_saver: cells with a larger probability are written as occupied."""
FREE_THRESH = 0.196
"""Default of map_saver: cells with a smaller probability are written as free."""

_OCCUPIED, _FREE, _UNKNOWN = 0, 254, 205


def save_map_server(
    path_yaml: str | os.PathLike[str],
    occupancy_probability: ArrayLike,
    resolution: float,
    origin: tuple[float, float],
) -> None:
    """Write a map as a YAML file and a PGM image beside it, of the same name.

    Each file appears under its name only when it is complete, the image first: a reader sees no
    half-written file. An existing map is replaced.

    Parameters
    ----------
    path_yaml : path
        The YAML file, ending in .yaml or .yml, in a folder that exists.
    occupancy_probability : (nx, ny) float array
        P(occupied) in [0, 1], the first axis x; NaN where unknown. Values between `FREE_THRESH`
        and `OCCUPIED_THRESH` are written as unknown, too.
    resolution : float
        Side of a cell in metres.
    origin : (float, float)
        Position in metres of the lower corner of cell (0, 0).

    Raises
    ------
    ValueError
        With the value, if an argument is not as described.
    ImportError
        With the pip command, if PyYAML is not installed.
    """
    yaml = require("yaml", "maps")
    path = Path(path_yaml)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ValueError(f"path_yaml must end in .yaml or .yml, not {str(path)!r}")
    check_resolution(resolution)
    if len(origin) != 2 or not all(math.isfinite(metres) for metres in origin):
        raise ValueError(f"origin must be two finite numbers (x, y), not {origin!r}")
    image = path.with_suffix(".pgm")
    fields = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(resolution),
        "origin": [float(origin[0]), float(origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH,
        "free_thresh": FREE_THRESH,
    }
    _write(image, _pgm(np.asarray(occupancy_probability, dtype=np.float64)))
    _write(path, yaml.safe_dump(fields, sort_keys=False, allow_unicode=True).encode())


def _pgm(probability: np.ndarray) -> bytes:
    """Binary PGM of the map, its top row the largest y."""
    if probability.ndim != 2 or probability.size == 0:
        raise ValueError(f"occupancy_probability must have shape (nx, ny), not {probability.shape}")
    outside = (probability < 0.0) | (probability > 1.0)
    if outside.any():
        raise ValueError(
            f"occupancy_probability must lie in [0, 1] or be NaN, not {probability[outside][0]}"
        )
    gray = np.full(probability.shape, _UNKNOWN, dtype=np.uint8)
    gray[probability > OCCUPIED_THRESH] = _OCCUPIED
    gray[probability < FREE_THRESH] = _FREE
    n_x, n_y = probability.shape
    return b"P5\n%d %d\n255\n" % (n_x, n_y) + gray.T[::-1].tobytes()


def _write(path: Path, content: bytes) -> None:
    """Write a file beside its place, then move it there in one step."""
    unfinished = path.with_name(f".{path.name}.{uuid.uuid4().hex}.tmp")
    try:
        unfinished.write_bytes(content)
        os.replace(unfinished, path)
    finally:
        unfinished.unlink(missing_ok=True)
