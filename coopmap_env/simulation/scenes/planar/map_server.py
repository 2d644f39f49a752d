"""Maps in the form of ROS map_server: a YAML file and the image that it names.

The gray value v of a pixel (0 to 255) says how surely its cell is occupied,

    p = (255 - v) / 255, or v / 255 if negate,

occupied above ``occupied_thresh``, free below ``free_thresh``, unknown in between. As the truth of
a world, unknown cells count as occupied: nothing is known to be free there, so no robot may start
or be credited for seeing beyond. The top row of an image has the largest y; the first axis of a
world is x.

The modes of map_server are read as follows: ``trinary`` and ``scale`` as above (the shades that
``scale`` keeps between the thresholds are not free); in ``raw`` v is a percentage and values above
100 are unknown. Pixels that are not opaque are unknown in every mode, as in ``scale``; map_server
mixes opacity into the gray value in ``trinary``, which makes black and white less sure.
"""

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.simulation.scenes.planar.recorded import RecordedMap, SceneError, max_pool
from coopmap_env.simulation.scenes.planar.world import PlanarWorld
from coopmap_env.simulation.scenes.yaml_file import read_yaml

MODES = ("trinary", "scale", "raw")


@dataclass(frozen=True)
class MapServerFields:
    """What the YAML file says."""

    image: Path
    """Where the image lies; in the file relative to the file."""
    resolution: float
    """Side of a pixel in metres."""
    origin: tuple[float, float]
    """Lower left corner of the image in metres."""
    negate: bool
    """White is occupied instead of black."""
    occupied_thresh: float
    """Cells with a larger p are occupied."""
    free_thresh: float
    """Cells with a smaller p are free."""
    mode: str
    """One of `MODES`."""


def read_map_server(path: str | os.PathLike[str], pool: int = 1) -> RecordedMap:
    """Read a recorded map.

    Parameters
    ----------
    path : path
        The YAML file.
    pool : int
        Pixels per side of a cell: a cell is occupied if any of its pixels is, and the resolution
        grows by this factor.

    Returns
    -------
    RecordedMap
        Named after the file.

    Raises
    ------
    SceneError
        If a file is missing, unreadable or no usable world.
    ImportError
        With the pip command, if PyYAML or Pillow is not installed.
    """
    path = Path(path)
    fields = _read_fields(path)
    occupied = max_pool(~_free_cells(path, fields), pool)
    try:
        world = PlanarWorld(occupied, fields.resolution * pool, fields.origin, path.stem)
    except ValueError as error:
        raise SceneError(f"{path}: image {str(fields.image)!r} makes no world: {error}") from error
    return RecordedMap(world)


def _read_fields(path: Path) -> MapServerFields:
    content = read_yaml(path)
    fields = _Fields(path, content)
    free, occupied = fields.fraction("free_thresh"), fields.fraction("occupied_thresh")
    if free > occupied:
        raise SceneError(
            f"{path}: free_thresh must not exceed occupied_thresh ({occupied}), not {free}"
        )
    mode, negate = fields.mode(), fields.negate()
    if mode == "raw" and negate:
        # ROS 1 inverts raw values then, ROS 2 does not.
        raise SceneError(f"{path}: negate must be 0 in mode raw, whose readers disagree on it")
    return MapServerFields(
        image=path.parent / fields.image(),
        resolution=fields.resolution(),
        origin=fields.origin(),
        negate=negate,
        occupied_thresh=occupied,
        free_thresh=free,
        mode=mode,
    )


@dataclass(frozen=True)
class _Fields:
    """Typed access to the content of a YAML file, with errors that name file and field."""

    path: Path
    content: Mapping[str, Any]

    def value(self, field: str) -> Any:
        if field not in self.content:
            raise SceneError(f"{self.path}: {field} is missing")
        return self.content[field]

    def wrong(self, field: str, expected: str) -> SceneError:
        return SceneError(f"{self.path}: {field} must be {expected}, not {self.content[field]!r}")

    def image(self) -> str:
        name = self.value("image")
        if not isinstance(name, str) or not name or "\0" in name:
            raise self.wrong("image", "the path of an image")
        return name

    def resolution(self) -> float:
        metres = _number(self.value("resolution"))
        if not 0.0 < metres < math.inf:
            raise self.wrong("resolution", "a finite number of metres above 0")
        return metres

    def origin(self) -> tuple[float, float]:
        values = self.value("origin")
        numbers = [_number(value) for value in values] if isinstance(values, list) else []
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise self.wrong("origin", "three finite numbers [x, y, yaw]")
        if numbers[2] != 0.0:
            raise self.wrong("origin", "without yaw (rotated maps are not read: rotate the image)")
        return numbers[0], numbers[1]

    def fraction(self, field: str) -> float:
        fraction = _number(self.value(field))
        if not 0.0 <= fraction <= 1.0:
            raise self.wrong(field, "a number in [0, 1]")
        return fraction

    def negate(self) -> bool:
        value = self.value("negate")
        if not isinstance(value, int) or value not in (0, 1):
            raise self.wrong("negate", "0 or 1")
        return bool(value)

    def mode(self) -> str:
        if "mode" not in self.content:
            return "trinary"
        mode = self.content["mode"]
        if mode not in MODES:
            raise self.wrong("mode", f"one of {', '.join(MODES)}")
        return str(mode)


def _number(value: object) -> float:
    """Read a YAML scalar as a number, NaN if it is none.

    ``5e-2`` is a string to PyYAML (YAML 1.1 wants ``5.0e-2``) and a number to map_server.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return math.nan
    try:
        return float(value)
    except (ValueError, OverflowError):
        return math.nan


def _free_cells(path: Path, fields: MapServerFields) -> NDArray[np.bool_]:
    """Cells (nx, ny) that the image shows as free."""
    gray, opaque = _read_image(path, fields.image)
    white = 255.0
    if fields.mode == "raw":
        p = gray / 100  # what is unknown lies above 1, and so above any free_thresh
    elif fields.negate:
        p = gray / white
    else:
        p = (white - gray) / white
    free = (p < fields.free_thresh) & opaque
    return np.ascontiguousarray(free[::-1].T)


def _read_image(path: Path, image: Path) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Gray values (rows, columns) from 0 to 255, and which pixels are opaque."""
    pillow = import_optional("PIL.Image", "maps")
    try:
        with pillow.open(image) as file:
            if file.mode.startswith("I"):  # 16 bits per pixel
                gray = np.asarray(file, dtype=np.float64) / 257
                return gray, np.ones(gray.shape, dtype=np.bool_)
            pixels = np.asarray(file.convert("RGBA"), dtype=np.float64)
    except (OSError, ValueError, SyntaxError, EOFError, pillow.DecompressionBombError) as error:
        raise SceneError(
            f"{path}: image must name a readable PGM or PNG file, not {str(image)!r}: {error}"
        ) from error
    return pixels[:, :, :3].mean(axis=2), pixels[:, :, 3] == 255
