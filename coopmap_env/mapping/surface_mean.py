"""The surface in a cell as the mean of its points, with the uncertainty that this mean has.

Eq. 4 merges the points of a cell as if all were observations of one point, with independent errors.
They are not: points lie anywhere on the face that crosses the cell, and all points of a scan share
the error of its camera pose. So, for the most part, do all scans: the offsets of the encoders, the
base's pose and the springs stay as they are, and the reading of a mount that does not move is the
same. The product of their densities is then too certain, and it can lie off the face, as lines of
sight to different points of a face need not meet on it.

Here each point x_i, of covariance C_i, counts alike. The mean of n points of a plane lies in that
plane, wherever on it they are. Its covariance is that of the sum of their errors over n**2,

    C = (1 / n**2) * (sum of C_i + (n - 1) * sum of S_i) + r * I

S_i being the covariance that the camera pose gives to a point of this cell, which is a part of C_i
already. So range noise shrinks with the number of points, the pose's error does not. This takes
the poses of all scans for equally wrong, in the same direction. What is not, the noise of each
new reading of the encoders or another robot, makes C too large, not too small.

Where the face is not a plane (an edge, a corner), the mean is off the surface. The points then
scatter in every direction more than their noise explains. r is the smallest eigenvalue of this
excess of their covariance matrix,

    (1 / n) * sum of ((x_i - mean) (x_i - mean)^T - C_i) + C

times n / (n - D), as a plane that fits n points has D parameters; 0 if that is negative, and with
D points or fewer.

All is made from sums over points and scans, which can be added in any order, and taken away again.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.linear_algebra import smallest_eigenvalue
from coopmap_env.mapping.arrays import SurfaceArrays
from coopmap_env.mapping.grid import GridGeometry, write_center
from coopmap_env.sensing import pose_term


@borrowing_kernel
def add_point(
    surfaces: SurfaceArrays,
    row: int,
    C: NDArray[np.float64],
    deviation: NDArray[np.float64],
    floor: float,
) -> None:
    """Add a point of covariance C + floor I to a row; the deviation is from the cell's center."""
    count, total, noise, scatter, _ = surfaces
    c = np.uint64(row)
    count[c, 0, 0] += 1.0
    if len(deviation) == 3:  # a constant number of turns: the compiler writes them out
        for i in range(3):
            total[c, i] += deviation[i]
            for j in range(3):
                variance = C[i, j] + (floor if i == j else 0.0)
                noise[c, i, j] += variance
                scatter[c, i, j] += deviation[i] * deviation[j] - variance
        return
    for i in range(2):
        total[c, i] += deviation[i]
        for j in range(2):
            variance = C[i, j] + (floor if i == j else 0.0)
            noise[c, i, j] += variance
            scatter[c, i, j] += deviation[i] * deviation[j] - variance


@kernel
def add_shared_errors(
    surfaces: SurfaceArrays,
    cells: NDArray[np.int64],
    rows: NDArray[np.int64],
    origin: NDArray[np.float64],
    pose_covariance: NDArray[np.float64],
    grid: GridGeometry,
    n_points: NDArray[np.int32],
) -> None:
    """Add m S of one 3-D scan to each cell that holds m of its points.

    `cells` are those of the scan's points and `rows` theirs, -1 for none; `n_points` (n_cells,) is
    a buffer of zeros. S is taken at the cell's center.
    """
    center = np.zeros(3)
    for row in rows:
        if row >= 0:
            n_points[row] += 1
    for k in range(len(rows)):
        row = rows[k]
        if row < 0 or n_points[row] == 0:
            continue
        m = n_points[row]
        n_points[row] = 0
        write_center(grid, cells[k], center)
        S = pose_term(
            pose_covariance, center[0] - origin[0], center[1] - origin[1], center[2] - origin[2]
        )
        shared = surfaces.shared[row]
        shared[0, 0] += m * S.xx
        shared[1, 1] += m * S.yy
        shared[2, 2] += m * S.zz
        shared[0, 1] += m * S.yx
        shared[1, 0] += m * S.yx
        shared[0, 2] += m * S.zx
        shared[2, 0] += m * S.zx
        shared[1, 2] += m * S.zy
        shared[2, 1] += m * S.zy


@kernel
def mean_gaussian(
    surfaces: SurfaceArrays,
    row: int,
    deviation: NDArray[np.float64],
    covariance: NDArray[np.float64],
) -> None:
    """Write the mean of a row's points, from the cell's center (D,), and its covariance (D, D)."""
    n = surfaces.precision[row, 0, 0]
    D = len(deviation)
    excess = np.empty((D, D))
    for i in range(D):
        deviation[i] = surfaces.information_vector[row, i] / n
    for i in range(D):
        for j in range(D):
            errors = surfaces.noise[row, i, j] + (n - 1.0) * surfaces.shared[row, i, j]
            covariance[i, j] = errors / (n * n)
            spread = surfaces.scatter[row, i, j] / n - deviation[i] * deviation[j]
            excess[i, j] = spread + covariance[i, j]
    if n > D:
        roughness = max(smallest_eigenvalue(excess), 0.0) * n / (n - D)
        for i in range(D):
            covariance[i, i] += roughness


@kernel
def mean_gaussians(
    surfaces: PlainTuple,
    rows: NDArray[np.int64],
    deviations: NDArray[np.float64],
    covariances: NDArray[np.float64],
) -> None:
    """`mean_gaussian` of rows (k,), into (k, D) and (k, D, D); a plain `SurfaceArrays`."""
    arrays = SurfaceArrays(*surfaces)
    for k in range(len(rows)):
        mean_gaussian(arrays, rows[k], deviations[k], covariances[k])
