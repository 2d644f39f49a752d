"""Planar maps in the form of ROS map_server: a YAML file and the image that it names.

``trinary`` (default): a PGM image of three gray values, as map_saver writes them: occupied 0, free
254, unknown 205. With a ``free_thresh`` of 0.196 the 205 of unknown (p = 50/255 = 0.1961) is just
not free. ``scale``: a PNG image whose gray value is 255 (1 - p) and whose unknown cells are
transparent. Both lose information: trinary all but the verdict, scale what 8 bits do not hold.
Reading is described in `map_server_image`.
"""

from __future__ import annotations

import io
import math
import os
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import write_atomically
from coopmap_env.mapping.files.base import errors_naming
from coopmap_env.mapping.files.map_server_image import MapServerImage, read_map_server_image
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import to_log_odds_fixed
from coopmap_env.mapping.occupancy_map import OccupancyMap

OCCUPIED_THRESH = 0.65
"""Default of map_saver: cells with a larger probability are written as occupied."""
FREE_THRESH = 0.196
"""Default of map_saver: cells with a smaller probability are written as free."""
WRITABLE_MODES = ("trinary", "scale")

_OCCUPIED, _FREE, _UNKNOWN = 0, 254, 205


def save_map_server(
    map_: OccupancyMap, path: str | os.PathLike[str], mode: str = "trinary"
) -> None:
    """Write a planar map, its never sampled cells as unknown.

    Raises
    ------
    ValueError
        If the map is not planar, or as in `write_map_server`.
    """
    if map_.grid.dimension != 2:
        raise ValueError(f"map_server's files hold planar maps, not {map_.grid.shape}: use .npz")
    x, y = map_.grid.origin
    probability = np.where(map_.sampled, map_.probability, np.nan)
    write_map_server(path, probability, map_.grid.resolution, (x, y), mode)


def write_map_server(
    path_yaml: str | os.PathLike[str],
    occupancy_probability: ArrayLike,
    resolution: float,
    origin: tuple[float, float],
    mode: str = "trinary",
) -> None:
    """Write probabilities as a YAML file and an image beside it, of the same name.

    Each file appears under its name only when it is complete, the image first: a reader sees no
    half-written file. An existing map is replaced.

    Parameters
    ----------
    path_yaml : path
        The YAML file, ending in .yaml or .yml, in a folder that exists.
    occupancy_probability : (nx, ny) float array
        P(occupied) in [0, 1], the first axis x; NaN where unknown. Trinary: values between
        `FREE_THRESH` and `OCCUPIED_THRESH` are written as unknown, too.
    resolution : float
        Side of a cell in metres.
    origin : (float, float)
        Position in metres of the lower corner of cell (0, 0).
    mode : {"trinary", "scale"}

    Raises
    ------
    ValueError
        With the value, if an argument is not as described.
    ImportError
        With the pip command, if PyYAML (or, for "scale", Pillow) is not installed.
    """
    yaml = import_optional("yaml", "maps")
    path = Path(path_yaml)
    if path.suffix.lower() not in (".yaml", ".yml"):
        raise ValueError(f"path_yaml must end in .yaml or .yml, not {str(path)!r}")
    if mode not in WRITABLE_MODES:
        raise ValueError(f"mode must be one of {', '.join(WRITABLE_MODES)}, not {mode!r}")
    if not (math.isfinite(resolution) and resolution > 0):
        raise ValueError(f"resolution must be a finite length above 0 m, not {resolution!r}")
    if len(origin) != 2 or not all(math.isfinite(metres) for metres in origin):
        raise ValueError(f"origin must be two finite numbers (x, y), not {origin!r}")
    probability = _validate_probability(np.asarray(occupancy_probability, dtype=np.float64))
    trinary = mode == "trinary"
    image = path.with_suffix(".pgm" if trinary else ".png")
    fields = {
        "image": image.name,
        "mode": mode,
        "resolution": float(resolution),
        "origin": [float(origin[0]), float(origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": OCCUPIED_THRESH if trinary else 1.0,
        "free_thresh": FREE_THRESH if trinary else 0.0,
    }
    write_atomically(image, _pgm(probability) if trinary else _png(probability))
    write_atomically(path, yaml.safe_dump(fields, sort_keys=False, allow_unicode=True).encode())


def _validate_probability(probability: NDArray[np.float64]) -> NDArray[np.float64]:
    if probability.ndim != 2 or probability.size == 0:
        raise ValueError(f"occupancy_probability must have shape (nx, ny), not {probability.shape}")
    outside = (probability < 0.0) | (probability > 1.0)
    if outside.any():
        raise ValueError(
            f"occupancy_probability must lie in [0, 1] or be NaN, not {probability[outside][0]}"
        )
    return probability


def _pgm(probability: NDArray[np.float64]) -> bytes:
    """Binary PGM of the map, its top row the largest y."""
    gray = np.full(probability.shape, _UNKNOWN, dtype=np.uint8)
    gray[probability > OCCUPIED_THRESH] = _OCCUPIED
    gray[probability < FREE_THRESH] = _FREE
    n_x, n_y = probability.shape
    return b"P5\n%d %d\n255\n" % (n_x, n_y) + gray.T[::-1].tobytes()


def _png(probability: NDArray[np.float64]) -> bytes:
    """PNG of gray value and opacity, its top row the largest y."""
    known = np.isfinite(probability)
    gray = np.rint(255 * (1.0 - np.where(known, probability, 0.5))).astype(np.uint8)
    pixels = np.stack([gray, np.where(known, 255, 0).astype(np.uint8)], axis=-1)
    buffer = io.BytesIO()
    image = np.ascontiguousarray(pixels.transpose(1, 0, 2)[::-1])
    import_optional("PIL.Image", "maps").fromarray(image).save(buffer, "PNG")
    return buffer.getvalue()


def load_map_server(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read a planar map that this library, map_saver or another writer of map_server's form wrote.

    Occupied and free cells are at the map's clamp. Cells between the thresholds are unknown in
    mode trinary and at their probability in scale; in raw, where thresholds do not count, every
    known cell is at its probability.

    Warns
    -----
    UserWarning
        As in `read_map_server_image`.

    Raises
    ------
    MapFileError
        If a file is missing or broken, or a field is not as expected.
    ImportError
        With the pip command, if PyYAML or Pillow is not installed.
    """
    image = read_map_server_image(path)
    with errors_naming(path):
        return _make_map(image)


def _make_map(image: MapServerImage) -> OccupancyMap:
    fields, p = image.fields, image.occupancy
    sampled = np.isfinite(p)
    if fields.mode == "raw":
        occupied, free = p >= 1.0, p <= 0.0
    else:
        occupied, free = p >= fields.occupied_thresh, image.free
    if fields.mode == "trinary":
        sampled = occupied | free
    map_ = OccupancyMap(VoxelGrid(p.shape, fields.resolution, fields.origin))
    clamp = map_.log_odds_range.clamp
    log_odds_fixed = np.zeros(p.shape, dtype=np.int32)
    between = sampled & ~occupied & ~free
    values, indices = np.unique(p[between], return_inverse=True)
    levels = [min(max(to_log_odds_fixed(value), -clamp), clamp) for value in values.tolist()]
    log_odds_fixed[between] = np.array(levels, dtype=np.int32)[indices]
    log_odds_fixed[occupied], log_odds_fixed[free] = clamp, -clamp
    map_.log_odds_fixed[:] = log_odds_fixed.ravel()
    map_.sampled_mask[:] = sampled.ravel()
    return map_
