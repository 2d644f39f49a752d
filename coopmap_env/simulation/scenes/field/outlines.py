"""How far vertical axes are from what stands there, seen from above."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.simulation.scenes.field.solid import Solid


def project_to_ground(solids: Sequence[Solid]) -> NDArray[np.float64]:
    """Triangles (m, 3, 2) of all solids but the ground, seen from above."""
    seen = [solid.triangles[:, :, :2] for solid in solids if not solid.is_ground]
    return np.concatenate([np.zeros((0, 3, 2)), *seen])


def distance_to_axis(point: ArrayLike, solids: Sequence[Solid]) -> float:
    """Horizontal distance in metres from a vertical axis at (x, y) to the nearest solid.

    0 if the axis passes through one, infinite if there is none; ground does not count.
    """
    x, y = np.asarray(point, dtype=np.float64)[:2]
    return float(distance_to_triangles(x, y, project_to_ground(solids)))


@njit(cache=True, nogil=True)
def distance_to_triangles(x, y, triangles):
    """Distance from (x, y) to triangles (m, 3, 2) in the plane, 0 inside of one."""
    nearest = math.inf
    for m in range(len(triangles)):
        left, right = True, True
        for k in range(3):
            after = (k + 1) % 3
            ex = triangles[m, after, 0] - triangles[m, k, 0]
            ey = triangles[m, after, 1] - triangles[m, k, 1]
            px, py = x - triangles[m, k, 0], y - triangles[m, k, 1]
            length = ex * ex + ey * ey
            fraction = 0.0  # a vertical edge is a point
            if length > 0.0:
                fraction = min(max((ex * px + ey * py) / length, 0.0), 1.0)
            nearest = min(nearest, (px - fraction * ex) ** 2 + (py - fraction * ey) ** 2)
            side = ex * py - ey * px
            left, right = left and side > 0.0, right and side < 0.0
        if left or right:
            return 0.0
    return math.sqrt(nearest)
