"""Normals of the surfaces in a depth image, and their variances.

The inverse depth of a plane is an affine function of the image coordinates, 1/x = a + b u + c v
with u = y/x and v = z/x, and its normal is along (a, b, c). Where the depth's standard deviation
grows with its square (Eq. 1, n = 2), that of the inverse depth is the same everywhere, so plain
least squares over a window of pixels has no bias. A fit of planes to points in space, by their
scatter, would mistake noise along the optical axis for extent, as it is many times that across.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import kernel
from coopmap_env.sensing import (
    DepthCamera,
    NoiseParameters,
    PinholeIntrinsics,
    PointCloud,
    RangeNoise,
)

MAX_RESIDUAL_RATIO = (1.6, 2.2)
"""Mean square of the residuals over that of the noise, in windows of 5 x 5 pixels (22 degrees of
freedom) and of 3 x 3 (6), up to which a window is a plane; noise alone exceeds it once in 30."""
MIN_RELATIVE_STD = 1e-6
"""Relative error of an inverse depth from rounding: a camera without noise has this one."""


class SurfaceNormals(NamedTuple):
    """Planes fitted around the pixels of a scan."""

    normals: NDArray[np.float64]
    """Shape (n, 3): unit vectors towards the camera, camera frame; 0 where no plane fits."""
    normal_variances: NDArray[np.float64]
    """Shape (n,): variance of the normal along each axis across it, square radians; for pixels
    near the optical axis, a third less than it is at the corners of the default image."""
    planar: NDArray[np.bool_]
    """Shape (n,): where a plane fits."""


def surface_normals(cloud: PointCloud, camera: DepthCamera, noise: RangeNoise) -> SurfaceNormals:
    """Fit planes around each pixel: over 5 x 5 pixels, or 3 x 3 where the larger is no plane.

    Parameters
    ----------
    cloud : PointCloud
        A point for each pixel of the camera, row by row, in the camera frame.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1, with which the residuals are compared.
    """
    n = camera.n_pixels
    fitted = SurfaceNormals(np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.bool_))
    fit_planes(
        np.ascontiguousarray(cloud.points, dtype=np.float64),
        np.ascontiguousarray(cloud.hit),
        camera.intrinsics,
        noise.parameters,
        fitted,
    )
    return fitted


@kernel
def fit_planes(
    points: NDArray[np.float64],
    hit: NDArray[np.bool_],
    intrinsics: PinholeIntrinsics,
    noise: NoiseParameters,
    fitted: SurfaceNormals,
) -> None:
    """Fill the normals of points (n, 3) in the camera frame."""
    width, height, tan_x, tan_y = intrinsics
    scale = noise.intrinsic * noise.depth
    du, dv = 2.0 * tan_x / width, 2.0 * tan_y / height
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            k = row * width + column
            if not hit[k]:
                continue
            x, y, z = points[k, 0], points[k, 1], points[k, 2]
            deviation = scale * power(x * x + y * y + z * z, 0.5 * noise.exponent) / (x * x)
            deviation = max(deviation, MIN_RELATIVE_STD / x)
            for half in (2, 1):
                if min(row, height - 1 - row, column, width - 1 - column) < half:
                    continue
                is_complete, a, b, c, squares = _window_sums(points, hit, k, half, width)
                if not is_complete:
                    continue
                count = (2 * half + 1) ** 2
                moment = count * half * (half + 1) / 3.0
                residual = squares - a * a / count - (b * b + c * c) / moment
                limit = MAX_RESIDUAL_RATIO[0] if half == 2 else MAX_RESIDUAL_RATIO[1]
                if residual > limit * (count - 3) * deviation * deviation:
                    continue
                b, c = b / (moment * du), c / (moment * dv)
                # of the affine function, a is the value on the optical axis
                u, v = tan_x - (column + 0.5) * du, tan_y - (row + 0.5) * dv
                a = a / count - b * u - c * v
                length = math.sqrt(a * a + b * b + c * c)
                if a * x + b * y + c * z <= 0.0:
                    continue
                normals = fitted.normals
                normals[k, 0], normals[k, 1], normals[k, 2] = -a / length, -b / length, -c / length
                fitted.normal_variances[k] = (deviation / (length * du)) ** 2 / moment
                fitted.planar[k] = True
                break


@kernel
def _window_sums(
    points: NDArray[np.float64], hit: NDArray[np.bool_], k: int, half: int, width: int
) -> tuple[bool, float, float, float, float]:
    """Sums of 1/x, of its products with the offsets to left and up, and of its square.

    Over the window of 2 half + 1 pixels around pixel k; not complete if one measured nothing.
    """
    a, b, c, squares = 0.0, 0.0, 0.0, 0.0
    for i in range(-half, half + 1):
        for j in range(-half, half + 1):
            m = k + i * width + j
            if not hit[m]:
                return False, a, b, c, squares
            inverse = 1.0 / points[m, 0]
            a += inverse
            b -= inverse * j  # u grows to the left, v upwards
            c -= inverse * i
            squares += inverse * inverse
    return True, a, b, c, squares
