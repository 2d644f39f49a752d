"""Reading the files of ROS map_server: a YAML file and the image that it names.

The gray value v of a pixel (0 to 255; of colours the mean of the channels) is the occupancy of its
cell,

    p = (255 - v) / 255, or v / 255 if negate,

occupied from ``occupied_thresh`` on (>=), free up to ``free_thresh`` (<=), as in nav2_map_server;
map_server of ROS 1 leaves a p that equals a threshold unknown. In between, a cell is unknown
(mode ``trinary``), or p is its probability (``scale``). In mode ``raw`` v is a percentage, unknown
above 100. Pixels that are not opaque are unknown in every mode.

`read_map_server_image` serves occupancy maps (`load_map_server`) and recorded scenes alike.
"""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief, read_bytes
from coopmap_env.core.yaml_files import read_yaml_mapping, read_yaml_number
from coopmap_env.mapping.files._gray_image import decode_gray_image
from coopmap_env.mapping.files.base import MapFileError

MODES = ("trinary", "scale", "raw")
MAX_YAW = 1e-6
"""Radians: what rounding leaves of no rotation moves no pixel."""
MAP_SAVER_UNKNOWN = 205
"""Gray value that map_saver writes for unknown cells."""
MAP_SAVER_GRAYS = (0, MAP_SAVER_UNKNOWN, 254)
"""Gray values of a map that map_saver wrote: occupied, unknown, free."""


@dataclass(frozen=True)
class MapServerFields:
    """Content of the YAML file."""

    image: Path
    """Path of the image; relative to the YAML file in the file itself."""
    resolution: float
    """Edge of a pixel, metres."""
    origin: tuple[float, float]
    """Lower left corner of the image, metres."""
    negate: bool
    """White is occupied instead of black."""
    occupied_thresh: float
    """Cells of this p or a larger one are occupied."""
    free_thresh: float
    """Cells of this p or a smaller one are free."""
    mode: str
    """One of `MODES`."""


@dataclass(frozen=True)
class MapServerImage:
    """A map as its files have it, before anybody decides what is free."""

    fields: MapServerFields
    occupancy: NDArray[np.float64]
    """p of each cell in [0, 1], shape (nx, ny); NaN where unknown. The top row of the image has the
    largest y."""

    @property
    def free(self) -> NDArray[np.bool_]:
        """Which cells are free, shape (nx, ny)."""
        return self.occupancy <= self.fields.free_thresh


def read_map_server_image(path: str | os.PathLike[str]) -> MapServerImage:
    """Read a YAML file and its image: PGM, PNG, PPM, PBM, BMP, GIF or JPEG, 8 or 16 bits per value.

    Warns
    -----
    UserWarning
        If ``free_thresh`` makes cells free that map_saver wrote as unknown.

    Raises
    ------
    MapFileError
        With file and field, if a file is missing, unreadable or too large, or a field is not as
        expected.
    ImportError
        With the pip command, if PyYAML or Pillow is not installed.
    """
    path = Path(path)
    fields = _read_fields(path)
    try:
        gray, opaque = decode_gray_image(read_bytes(fields.image, MapFileError))
        _warn_of_free_unknown_cells(path, fields, gray)
        occupancy = _to_occupancy(fields, gray)
    except (ValueError, MemoryError) as error:
        raise MapFileError(
            f"{path}: image must name a readable PGM or PNG file, not {str(fields.image)!r:.300}: "
            f"{str(error) or type(error).__name__:.700}"
        ) from error
    if opaque is not None:
        occupancy[~opaque] = np.nan
    return MapServerImage(fields, np.ascontiguousarray(occupancy[::-1].T))


def _to_occupancy(fields: MapServerFields, gray: NDArray[np.float64]) -> NDArray[np.float64]:
    if fields.mode == "raw":
        percentage = np.rint(gray)
        return np.where(percentage <= 100.0, percentage / 100.0, np.nan)
    return gray / 255.0 if fields.negate else (255.0 - gray) / 255.0


def _warn_of_free_unknown_cells(
    path: Path, fields: MapServerFields, gray: NDArray[np.float64]
) -> None:
    p_unknown = (255 - MAP_SAVER_UNKNOWN) / 255
    if fields.mode == "raw" or fields.negate or fields.free_thresh < p_unknown:
        return
    n_unknown = int(np.count_nonzero(gray == MAP_SAVER_UNKNOWN))
    if n_unknown and np.isin(gray, MAP_SAVER_GRAYS).all():
        warnings.warn(
            f"{path}: free_thresh {fields.free_thresh} makes {n_unknown} cells free that have the "
            f"gray value {MAP_SAVER_UNKNOWN}, which map_saver writes for unknown: to keep them "
            "unknown, set free_thresh to 0.196",
            UserWarning,
            stacklevel=3,
        )


def _read_fields(path: Path) -> MapServerFields:
    fields = _Fields(path, read_yaml_mapping(path, MapFileError))
    free, occupied = fields.threshold("free_thresh"), fields.threshold("occupied_thresh")
    if free > occupied:
        raise MapFileError(
            f"{path}: free_thresh must not exceed occupied_thresh ({occupied}), not {free}"
        )
    mode, negate = fields.mode(), fields.negate()
    if mode == "raw" and negate:
        # ROS 1 inverts raw values then, ROS 2 does not.
        raise MapFileError(f"{path}: negate must be 0 in mode raw, whose readers disagree on it")
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
            raise MapFileError(f"{self.path}: {field} is missing")
        return self.content[field]

    def error(self, field: str, expected: str) -> MapFileError:
        return MapFileError(
            f"{self.path}: {field} must be {expected}, not {brief(self.content[field])}"
        )

    def image(self) -> str:
        name = self.value("image")
        if not isinstance(name, str) or not name or not _is_path(name):
            raise self.error("image", "the path of an image")
        return name

    def resolution(self) -> float:
        metres = read_yaml_number(self.value("resolution"))
        if not 0.0 < metres < math.inf:
            raise self.error("resolution", "a finite number of metres above 0")
        return metres

    def origin(self) -> tuple[float, float]:
        values = self.value("origin")
        numbers = [read_yaml_number(value) for value in values] if isinstance(values, list) else []
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)):
            raise self.error("origin", "three finite numbers [x, y, yaw]")
        if abs(numbers[2]) > MAX_YAW:
            raise self.error("origin", "without yaw (rotated maps are not read: rotate the image)")
        return numbers[0], numbers[1]

    def threshold(self, field: str) -> float:
        probability = read_yaml_number(self.value(field))
        if not 0.0 <= probability <= 1.0:
            raise self.error(field, "a number in [0, 1]")
        return probability

    def negate(self) -> bool:
        value = self.value("negate")
        number = float(value) if isinstance(value, bool) else read_yaml_number(value)
        if number not in (0.0, 1.0):
            raise self.error("negate", "0 or 1")
        return bool(number)

    def mode(self) -> str:
        if "mode" not in self.content:
            return "trinary"
        mode = self.content["mode"]
        if not isinstance(mode, str) or mode.lower() not in MODES:
            raise self.error("mode", f"one of {', '.join(MODES)}")
        return mode.lower()


def _is_path(name: str) -> bool:
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        return False
    return "\0" not in name
