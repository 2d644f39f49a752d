"""The depth camera: a pinhole with a field of view, a resolution, and a range that it measures."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class PinholeIntrinsics(NamedTuple):
    """What kernels need to project a point into an image; see `DepthCamera`."""

    width: int
    """Pixels of a row."""
    height: int
    """Pixels of a column."""
    tan_x: float
    """Tangent of half the horizontal field of view."""
    tan_y: float
    """Tangent of half the vertical field of view."""


@dataclass(frozen=True)
class DepthCamera:
    """A pinhole depth camera; camera frame: x along the optical axis, y to the left, z up.

    Pixels are counted row by row from the top left one: pixel k stands in row ``k // width``
    and column ``k % width``.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    horizontal_field_of_view: float = math.radians(60.0)
    """Radians, in (0, pi): between the left and the right edge of the image."""
    vertical_field_of_view: float = math.radians(45.0)
    """Radians, in (0, pi): between the upper and the lower edge of the image."""
    width: int = 64
    """Pixels of a row: 6 m ahead the default ones are 0.11 m apart, about a voxel."""
    height: int = 48
    """Pixels of a column."""
    near: float = 0.3
    """Metres: of surfaces nearer than this nothing is measured."""
    far: float = 6.0
    """Metres: surfaces further than this are not seen. Both bound the distance to the point, not
    its depth along the optical axis."""

    def __post_init__(self) -> None:
        for name in ("horizontal_field_of_view", "vertical_field_of_view"):
            value = getattr(self, name)
            if not 0 < value < math.pi:
                raise ValueError(f"DepthCamera.{name} must lie in (0, pi) radians: {value}")
        for name in ("width", "height"):
            value = getattr(self, name)
            if not (isinstance(value, int | np.integer) and value >= 1):
                raise ValueError(
                    f"DepthCamera.{name} must be a whole number of at least 1: {value}"
                )
        if not (math.isfinite(self.far) and 0 <= self.near < self.far):
            raise ValueError(
                "DepthCamera measures from near to far, 0 <= near < far < infinity: "
                f"near {self.near}, far {self.far}"
            )

    @property
    def n_pixels(self) -> int:
        """Beams of one look."""
        return self.width * self.height

    @property
    def depth_of_field(self) -> float:
        """Metres: how far the camera sees; the name that all cameras share."""
        return self.far

    @property
    def intrinsics(self) -> PinholeIntrinsics:
        """Size of the image and tangents of half the fields of view, for kernels."""
        return PinholeIntrinsics(
            int(self.width),
            int(self.height),
            math.tan(self.horizontal_field_of_view / 2),
            math.tan(self.vertical_field_of_view / 2),
        )

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Unit vectors through the pixel centres, shape (n_pixels, 3), camera frame; read-only."""
        left = math.tan(self.horizontal_field_of_view / 2)
        top = math.tan(self.vertical_field_of_view / 2)
        rays = np.ones((self.height, self.width, 3))
        rays[..., 1] = left * (1 - (2 * np.arange(self.width) + 1) / self.width)
        rays[..., 2] = top * (1 - (2 * np.arange(self.height)[:, None] + 1) / self.height)
        rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
        directions = rays.reshape(-1, 3)
        directions.flags.writeable = False
        return directions

    def depth_image(self, distances: ArrayLike) -> NDArray[np.float64]:
        """Depths along the optical axis, shape (height, width), metres, of distances (n_pixels,).

        Raises
        ------
        ValueError
            If there is not one distance a pixel.
        """
        distances = np.asarray(distances, dtype=np.float64)
        if distances.shape != (self.n_pixels,):
            raise ValueError(
                f"an image of {self.height} x {self.width} pixels needs distances "
                f"({self.n_pixels},), got {distances.shape}"
            )
        return (distances * self.directions[:, 0]).reshape(self.height, self.width)
