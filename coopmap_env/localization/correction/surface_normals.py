"""Which way the surfaces seen in a depth image face, and how well that is known.

The inverse depth of a plane is an affine function of the image coordinates, 1/x = a + b u + c v
with u = y/x and v = z/x, and its normal is along (a, b, c). Where the depth's standard deviation
grows with its square (Eq. 1, n = 2), that of the inverse depth is the same everywhere, so the plain
least squares over a window of pixels has no bias. A fit of planes to points in space, by their
scatter, takes noise along the optical axis for extent, as it is many times that across.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.localization.depth_rendering import pinhole_intrinsics
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise

MAX_RESIDUAL_RATIO = (1.6, 2.2)
"""Of the residuals' mean square over that of the noise, in windows of 5 x 5 (22 degrees of freedom)
and of 3 x 3 (6): up to there a window is taken as one plane; noise alone exceeds it once in 30."""


MIN_RELATIVE_STD = 1e-6
"""Of an inverse depth, as a share: a camera without noise still counts in finite numbers."""


class SurfaceNormals(NamedTuple):
    """Of each pixel of a look, where a plane fits its surroundings."""

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
        Eq. 1, against which residuals are held.
    """
    n = camera.n_pixels
    found = SurfaceNormals(np.zeros((n, 3)), np.zeros(n), np.zeros(n, dtype=np.bool_))
    fit_planes(
        np.ascontiguousarray(cloud.points, dtype=np.float64), np.ascontiguousarray(cloud.hit),
        pinhole_intrinsics(camera), float(noise.intrinsic * noise.depth), float(noise.exponent), *found,
    )  # fmt: skip
    return found


@njit(cache=True, nogil=True)
def fit_planes(points, hit, intrinsics, scale, exponent, normals, normal_variances, planar):
    """Fill `SurfaceNormals`; `intrinsics` is that of `pinhole_intrinsics`, `scale` is S T_depth of Eq. 1."""
    width, height, left, top = intrinsics
    du, dv = 2.0 * left / width, 2.0 * top / height
    for row in range(1, height - 1):
        for column in range(1, width - 1):
            k = row * width + column
            if not hit[k]:
                continue
            x, y, z = points[k, 0], points[k, 1], points[k, 2]
            deviation = scale * (x * x + y * y + z * z) ** (0.5 * exponent) / (x * x)
            deviation = max(deviation, MIN_RELATIVE_STD / x)
            for half in (2, 1):
                if min(row, height - 1 - row, column, width - 1 - column) < half:
                    continue
                a, b, c, squares = 0.0, 0.0, 0.0, 0.0
                is_complete = True
                for i in range(-half, half + 1):
                    for j in range(-half, half + 1):
                        m = k + i * width + j
                        if not hit[m]:
                            is_complete = False
                            break
                        inverse = 1.0 / points[m, 0]
                        a += inverse
                        b -= inverse * j  # u grows to the left, v upwards
                        c -= inverse * i
                        squares += inverse * inverse
                    if not is_complete:
                        break
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
                u, v = left - (column + 0.5) * du, top - (row + 0.5) * dv
                a = a / count - b * u - c * v
                length = math.sqrt(a * a + b * b + c * c)
                if a * x + b * y + c * z <= 0.0:
                    continue
                normals[k, 0], normals[k, 1], normals[k, 2] = -a / length, -b / length, -c / length
                normal_variances[k] = (deviation / (length * du)) ** 2 / moment
                planar[k] = True
                break
