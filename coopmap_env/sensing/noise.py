"""Uncertainty of a range observation: Eq. 1 in the camera frame, Eq. 3 in the world frame."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power_array
from coopmap_env.core.linear_algebra import product
from coopmap_env.core.settings import Bounds, Settings


class NoiseParameters(NamedTuple):
    """The constants of Eq. 1 as floats, as kernels take them; see `RangeNoise`."""

    intrinsic: float
    depth: float
    lateral: float
    exponent: float


NoiseFactor = Annotated[float, Bounds(at_least=0, largest=1_000)]


@dataclass(frozen=True)
class RangeNoise(Settings):
    """Standard deviation of a range observation (Eq. 1): sigma = S * T * d**n.

    The axes are those of the camera frame: x along the optical axis (depth, the least certain
    one), y and z across it.

    Raises
    ------
    ValueError
        If a value is negative or not finite, or `lateral` exceeds `depth`.
    """

    intrinsic: NoiseFactor = 0.0015
    """S, per metre at n = 2: stereo disparity error grows with range squared. 0.0015 is 0.15 m at
    10 m and 0.6 m at 20 m: at the end of the default depth of field, more than half a cell."""
    depth: NoiseFactor = 1.0
    """T along the optical axis."""
    lateral: NoiseFactor = 0.25
    """T across the optical axis: image points are known better than disparities."""
    exponent: Annotated[float, Bounds(at_least=0, largest=10)] = 2.0
    """n: 2 for stereo; 0 for a laser, whose error hardly depends on range."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.lateral > self.depth:
            raise ValueError(
                f"RangeNoise.lateral must not exceed depth, got {self.lateral} > {self.depth}"
            )

    @property
    def parameters(self) -> NoiseParameters:
        """The constants, for kernels."""
        return NoiseParameters(
            float(self.intrinsic), float(self.depth), float(self.lateral), float(self.exponent)
        )

    def standard_deviations(self, distance: ArrayLike, dimension: int) -> NDArray[np.float64]:
        """Eq. 1 for distances (...,) in metres: standard deviations (..., D), metres."""
        axes = np.array([self.depth, *(self.lateral,) * (dimension - 1)])
        scale = self.intrinsic * power_array(distance, self.exponent)
        return scale[..., None] * axes


def rotate_covariances(
    covariances: NDArray[np.float64], R_world_camera: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Eq. 3: covariances (..., D, D) of the camera frame, in the world frame: R C R^T."""
    return product(product(R_world_camera, covariances), R_world_camera.T)
