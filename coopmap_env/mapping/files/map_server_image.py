"""Reading the files of ROS map_server: a YAML file and the image that it names.

The gray value v of a pixel (0 to 255) is the occupancy of its cell,

    p = (255 - v) / 255, or v / 255 if negate,

occupied above ``occupied_thresh``, free below ``free_thresh``, unknown in between. The modes are
``trinary`` (only these three verdicts), ``scale`` (values between the thresholds count as
probabilities) and ``raw`` (v is a percentage, unknown above 100). Pixels that are not opaque are
unknown in every mode, as in ``scale``; map_server mixes opacity into the gray value in ``trinary``,
which makes black and white less certain.

`read_map_server_image` serves occupancy maps (`load_map_server`) and recorded scenes alike.
"""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import read_yaml_mapping, read_yaml_number
from coopmap_env.mapping.files.base import MapFileError

MODES = ("trinary", "scale", "raw")


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
    """Cells with a larger p are occupied."""
    free_thresh: float
    """Cells with a smaller p are free."""
    mode: str
    """One of `MODES`."""


@dataclass(frozen=True)
class MapServerImage:
    """A map as its files have it, before anybody decides what is free."""

    fields: MapServerFields
    occupancy: NDArray[np.float64]
    """p of each cell in [0, 1], shape (nx, ny); NaN where unknown. The top row of the image has the
    largest y."""


def read_map_server_image(path: str | os.PathLike[str]) -> MapServerImage:
    """Read a YAML file and its image (PGM or PNG, 8 or 16 bits per pixel).

    Raises
    ------
    MapFileError
        With file and field, if a file is missing or unreadable, or a field is not as expected.
    ImportError
        With the pip command, if PyYAML or Pillow is not installed.
    """
    path = Path(path)
    fields = _read_fields(path)
    gray, opaque = _read_image(path, fields.image)
    if fields.mode == "raw":
        p = gray / 100.0
    elif fields.negate:
        p = gray / 255.0
    else:
        p = (255.0 - gray) / 255.0
    occupancy = np.where(opaque & (p <= 1.0), p, np.nan)
    return MapServerImage(fields, np.ascontiguousarray(occupancy[::-1].T))


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
        return MapFileError(f"{self.path}: {field} must be {expected}, not {self.content[field]!r}")

    def image(self) -> str:
        name = self.value("image")
        if not isinstance(name, str) or not name or "\0" in name:
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
        if numbers[2] != 0.0:
            raise self.error("origin", "without yaw (rotated maps are not read: rotate the image)")
        return numbers[0], numbers[1]

    def threshold(self, field: str) -> float:
        probability = read_yaml_number(self.value(field))
        if not 0.0 <= probability <= 1.0:
            raise self.error(field, "a number in [0, 1]")
        return probability

    def negate(self) -> bool:
        value = self.value("negate")
        if not isinstance(value, int) or value not in (0, 1):
            raise self.error("negate", "0 or 1")
        return bool(value)

    def mode(self) -> str:
        if "mode" not in self.content:
            return "trinary"
        mode = self.content["mode"]
        if mode not in MODES:
            raise self.error("mode", f"one of {', '.join(MODES)}")
        return str(mode)


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
        raise MapFileError(
            f"{path}: image must name a readable PGM or PNG file, not {str(image)!r}: {error}"
        ) from error
    return pixels[:, :, :3].mean(axis=2), pixels[:, :, 3] == 255
