"""Camera models: a planar fan of beams, and a pinhole depth camera with a measuring range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import tan
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings

BYTES_PER_PIXEL = 200
"""Memory that a pixel takes in a scan: draws, distance, point and covariance."""


@dataclass(frozen=True)
class PlanarCamera(Settings):
    """A depth camera of one image row; its optical axis is the x axis of the camera frame.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    field_of_view: Annotated[float, Bounds(above=0, at_most=2 * math.pi)] = math.radians(60.0)
    """Radians. 60 degrees is that of a usual stereo camera."""
    depth_of_field: Positive = 20.0
    """Metres: surfaces farther than this are not measured."""
    n_beams: Annotated[int, Bounds(at_least=1, largest=10_000)] = 40
    """Pixels of the row: at the end of the default depth of field the beams are 0.5 m apart, so
    no 1 m cell falls between two of them."""

    @property
    def bearings(self) -> NDArray[np.float64]:
        """Angles of the beams to the optical axis, shape (n_beams,), radians: pixel centers."""
        pixel = self.field_of_view / self.n_beams
        return (np.arange(self.n_beams, dtype=np.float64) + 0.5) * pixel - self.field_of_view / 2


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
class DepthCamera(Settings):
    """A pinhole depth camera; camera frame: x along the optical axis, y to the left, z up.

    Pixels are counted row by row from the top left one: pixel k is in row ``k // width`` and
    column ``k % width``.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    horizontal_field_of_view: Annotated[float, Bounds(above=0, below=math.pi)] = math.radians(60.0)
    """Radians, between the left and the right edge of the image."""
    vertical_field_of_view: Annotated[float, Bounds(above=0, below=math.pi)] = math.radians(45.0)
    """Radians, between the upper and the lower edge of the image."""
    width: Annotated[int, Bounds(at_least=1, largest=10_000)] = 64
    """Pixels of a row: at 6 m the default ones are 0.11 m apart, about a voxel."""
    height: Annotated[int, Bounds(at_least=1, largest=10_000)] = 48
    """Pixels of a column."""
    near: NonNegative = 0.3
    """Metres: surfaces nearer than this are not measured."""
    far: Positive = 6.0
    """Metres: surfaces farther than this are not measured. Both bound the distance to the point,
    not its depth along the optical axis."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_bytes(BYTES_PER_PIXEL * self.n_pixels, "an image of DepthCamera.width x height")
        if not self.near < self.far:
            raise ValueError(
                f"DepthCamera.near must be below far, got near {self.near} and far {self.far}"
            )

    @property
    def n_pixels(self) -> int:
        """Beams of one scan."""
        return self.width * self.height

    @property
    def depth_of_field(self) -> float:
        """Metres: the largest range; every camera has this property."""
        return self.far

    @property
    def intrinsics(self) -> PinholeIntrinsics:
        """Size of the image and tangents of half the fields of view, for kernels."""
        return PinholeIntrinsics(
            int(self.width),
            int(self.height),
            tan(self.horizontal_field_of_view / 2),
            tan(self.vertical_field_of_view / 2),
        )

    @cached_property
    def directions(self) -> NDArray[np.float64]:
        """Unit vectors through the pixel centers, shape (n_pixels, 3), camera frame; read-only."""
        left = tan(self.horizontal_field_of_view / 2)
        top = tan(self.vertical_field_of_view / 2)
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
