"""The planar camera: a fan of beams with a field of view and a depth of field."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PlanarCamera:
    """A depth camera of one image row; its optical axis is the x axis of the camera frame.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    field_of_view: float = math.radians(60.0)
    """Radians, in (0, 2 pi]. 60 degrees is that of a usual stereo camera."""
    depth_of_field: float = 20.0
    """Metres: surfaces further than this are not seen."""
    n_beams: int = 40
    """Pixels of the row: at the end of the default depth of field the beams are 0.5 m apart, so
    no 1 m cell falls between two of them."""

    def __post_init__(self) -> None:
        if not 0 < self.field_of_view <= 2 * math.pi:
            raise ValueError(
                f"PlanarCamera.field_of_view must lie in (0, 2 pi] radians: {self.field_of_view}"
            )
        if not (math.isfinite(self.depth_of_field) and self.depth_of_field > 0):
            raise ValueError(
                f"PlanarCamera.depth_of_field must be finite and > 0: {self.depth_of_field}"
            )
        if not (isinstance(self.n_beams, int | np.integer) and self.n_beams >= 1):
            raise ValueError(
                f"PlanarCamera.n_beams must be a whole number of at least 1: {self.n_beams}"
            )

    @property
    def bearings(self) -> NDArray[np.float64]:
        """Angles of the beams to the optical axis, shape (n_beams,), radians: pixel centres."""
        pixel = self.field_of_view / self.n_beams
        return (np.arange(self.n_beams, dtype=np.float64) + 0.5) * pixel - self.field_of_view / 2
