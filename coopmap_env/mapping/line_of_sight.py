"""Lines of sight through a map: one exact ray through its voxels for each."""

from __future__ import annotations

import math

from coopmap_env.core.kernels import kernel
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.geometry.traversal import Vector
from coopmap_env.mapping.arrays import MapArrays


@kernel
def has_line_of_sight(
    arrays: MapArrays, start: Vector, end: Vector, occlusion_tolerance: float
) -> bool:
    """Whether no occupied voxel (sampled, P >= 1/2) lies between those of two points, in cells.

    Occupied voxels within `occlusion_tolerance` cells before the end do not block it. From outside
    of the grid nothing is seen.
    """
    shape = arrays.shape
    for axis in range(3):
        if not 0.0 <= start[axis] < shape[axis]:
            return False
    ux, uy, uz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    length = math.sqrt(ux * ux + uy * uy + uz * uz)
    ray, position = start_ray(start, (ux / length, uy / length, uz / length), shape)
    goal = (int(end[0]) * shape[1] + int(end[1])) * shape[2] + int(end[2])
    until = min(length - occlusion_tolerance, ray.end)
    own = position.cell
    while position.distance < until and position.cell != goal:
        cell = position.cell
        if cell != own and arrays.sampled_mask[cell] and arrays.log_odds_fixed[cell] >= 0:
            return False
        position = step_ray(ray, position)
    return True
