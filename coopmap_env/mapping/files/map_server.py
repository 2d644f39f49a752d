"""The planar map in the form of ROS map_server: a YAML file and the image that it names.

``trinary`` (default): a PGM image of three gray values, as map_saver writes them: occupied 0, free
254, unknown 205. With a ``free_thresh`` of 0.196 the 205 of unknown (p = 50/255 = 0.1961) is just
not free. ``scale``: a PNG image whose gray value is 255 (1 - p) and whose unknown cells are
transparent. Both lose: trinary all but the verdict, scale what 8 bits do not hold.
"""

from __future__ import annotations

import io
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import write_atomically
from coopmap_env.mapping.files.base import MapFileError, read_bytes
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import to_log_odds_fixed
from coopmap_env.mapping.occupancy_map import OccupancyMap

OCCUPIED_THRESH = 0.65
"""Default of map_saver: cells with a larger probability are written as occupied."""
FREE_THRESH = 0.196
"""Default of map_saver: cells with a smaller probability are written as free."""
MODES = ("trinary", "scale")

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
    if mode not in MODES:
        raise ValueError(f"mode must be one of {', '.join(MODES)}, not {mode!r}")
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
    """Read a map in mode trinary or scale, of ours or of map_saver's making.

    Cells above ``occupied_thresh`` and below ``free_thresh`` are at the map's clamp; cells in
    between are unknown in trinary, and at their probability in scale; transparent ones are unknown.

    Raises
    ------
    MapFileError
        If a file is missing or broken, or a field is not as expected.
    """
    fields = _read_fields(path)
    gray, opaque = _read_image(Path(path), Path(path).parent / fields["image"])
    p = gray / 255.0 if fields["negate"] else (255.0 - gray) / 255.0
    occupied, free = p > fields["occupied_thresh"], p < fields["free_thresh"]
    if fields["mode"] == "scale":
        occupied, free = p >= fields["occupied_thresh"], p <= fields["free_thresh"]
    map_ = OccupancyMap(VoxelGrid(p.shape, fields["resolution"], tuple(fields["origin"][:2])))
    clamp = map_.log_odds_range.clamp
    log_odds_fixed = np.zeros(p.shape, dtype=np.int32)
    between = opaque & ~occupied & ~free
    if fields["mode"] == "scale":
        log_odds_fixed[between] = [
            min(max(to_log_odds_fixed(value), -clamp), clamp) for value in p[between]
        ]
        between = np.zeros_like(between)
    log_odds_fixed[occupied], log_odds_fixed[free] = clamp, -clamp
    sampled = opaque & ~between
    map_.log_odds_fixed[:] = np.where(sampled, log_odds_fixed, 0).ravel()
    map_.sampled_mask[:] = sampled.ravel()
    return map_


def _read_fields(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Content of the YAML file, checked."""
    yaml = import_optional("yaml", "maps")
    try:
        fields = yaml.safe_load(read_bytes(path).decode())
        fields = {"mode": "trinary", **fields}
        numbers = ("resolution", "occupied_thresh", "free_thresh")
        fields.update({name: float(fields[name]) for name in numbers})
        fields["origin"] = [float(value) for value in fields["origin"]]
        good = (
            isinstance(fields["image"], str)
            and fields["mode"] in MODES
            and len(fields["origin"]) == 3
            and fields["origin"][2] == 0.0
            and fields["negate"] in (0, 1)
            and 0.0 < fields["resolution"] < math.inf
            and 0.0 <= fields["free_thresh"] <= fields["occupied_thresh"] <= 1.0
        )
    except MapFileError:
        raise
    except (yaml.YAMLError, KeyError, TypeError, ValueError) as error:
        raise MapFileError(f"{path} is no YAML file of map_server: {error!r}") from error
    if not good:
        raise MapFileError(
            f"{path}: expected image, mode {' or '.join(MODES)}, resolution > 0, origin "
            f"[x, y, 0.0], negate 0 or 1 and free_thresh <= occupied_thresh, got {fields}"
        )
    return fields


def _read_image(path: Path, image: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Gray values (nx, ny) from 0 to 255, and which pixels are opaque."""
    pillow = import_optional("PIL.Image", "maps")
    try:
        with pillow.open(image) as file:
            pixels = np.asarray(file.convert("LA"), dtype=np.float64)
    except (OSError, ValueError, SyntaxError, EOFError, pillow.DecompressionBombError) as error:
        raise MapFileError(f"{path}: its image {image} cannot be read: {error}") from error
    transposed = np.ascontiguousarray(pixels[::-1].transpose(1, 0, 2))
    return transposed[..., 0], transposed[..., 1] == 255
