"""Which cells scans truly show: those that beams without noise cross, up to the first surface.

The cell of the surface is included. What is shown depends on the true world and the poses of the
cameras alone, so that what any policy can show has a bound; noise lets maps have cells behind
surfaces, too. Only the simulation knows it: it is for scoring, and no part of a belief.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.sensing.beam_fan import FanArrays

SURFACE_DEPTH = 1e-6
"""Cells that a beam goes into the surface that it meets: one in the face of a voxel counts for the
voxel behind it."""


@borrowing_kernel
def list_planar_view(
    occupied: NDArray[np.bool_],
    shape: tuple[int, int],
    cell: int,
    heading: int,
    fan: FanArrays,
    alive: NDArray[np.uint64],
    cells: NDArray[np.int32],
) -> int:
    """List the cells that a scan from the center of a flat cell shows; return how many there are.

    `occupied` (n_cells,) is flat, `cells` has room for the largest view; `alive` (words,) is
    scratch.
    """
    (nx, ny), count = shape, 0
    ix, iy = cell // ny, cell % ny
    for word in range(len(alive)):
        alive[word] = fan.all_beams[word]
    for entry in range(fan.start[heading], fan.start[heading + 1]):
        k = np.uint64(entry)
        i, j = ix + fan.offsets[k, 0], iy + fan.offsets[k, 1]
        if i < 0 or i >= nx or j < 0 or j >= ny:
            continue
        crossed, is_seen = np.uint64(i * ny + j), False
        for word in range(len(alive)):
            crossing = alive[word] & fan.beams[word, k]
            is_seen |= crossing != 0
            if occupied[crossed]:
                alive[word] &= ~crossing
        if is_seen:
            cells[count] = crossed
            count += 1
    return count


@borrowing_kernel
def mark_planar_view(
    occupied: NDArray[np.bool_],
    shape: tuple[int, int],
    cell: int,
    heading: int,
    fan: FanArrays,
    alive: NDArray[np.uint64],
    cells: NDArray[np.int32],
    mask: NDArray[np.uint8],
) -> int:
    """Mark what a scan shows in `mask` (n_cells,); return how many cells were not marked before.

    The other arguments are those of `list_planar_view`.
    """
    count = 0
    for k in range(list_planar_view(occupied, shape, cell, heading, fan, alive, cells)):
        count += 1 - mask[cells[k]]
        mask[cells[k]] = 1
    return count


@borrowing_kernel
def _distance_to_grid(
    start: tuple[float, float, float],
    direction: tuple[float, float, float],
    shape: tuple[int, int, int],
) -> float:
    """Cells after which a ray is in the grid: 0 from inside; inf if it passes by."""
    enters, leaves = 0.0, math.inf
    for axis in range(3):
        position, along, size = start[axis], direction[axis], float(shape[axis])
        if along != 0.0:
            one, other = -position / along, (size - position) / along
            enters, leaves = max(enters, min(one, other)), min(leaves, max(one, other))
        elif not 0.0 <= position < size:
            return math.inf
    return enters if enters < leaves else math.inf


@inlined_kernel
def _inside(position: float, size: int) -> float:
    """A coordinate in cells, off the upper face of the grid at least."""
    return min(max(position, 0.0), size * (1.0 - 1e-12))


@kernel
def mark_depth_image(
    grid: PlainTuple,
    plain_camera: PlainTuple,
    directions: NDArray[np.float64],
    distances: NDArray[np.float64],
    near: float,
    far: float,
    mask: NDArray[np.uint8],
) -> int:
    """Mark the voxels that a depth image shows in `mask` (n_voxels,); return how many are new.

    `distances` (n,) are the true ones along the rays (n, 3) of the camera, metres; a surface nearer
    than `near` hides what its ray would show, and one beyond `far` is not seen. The camera may be
    outside of the grid. `grid` is a plain `GridGeometry`, `plain_camera` a plain `RigidTransform`.
    """
    lower, resolution, shape = grid
    R, t = plain_camera
    count = 0
    start = (
        (t[0] - lower[0]) / resolution,
        (t[1] - lower[1]) / resolution,
        (t[2] - lower[2]) / resolution,
    )
    for k in range(len(distances)):
        distance = distances[k]
        if distance < near:
            continue
        x, y, z = directions[k, 0], directions[k, 1], directions[k, 2]
        direction = (
            R[0, 0] * x + R[0, 1] * y + R[0, 2] * z,
            R[1, 0] * x + R[1, 1] * y + R[1, 2] * z,
            R[2, 0] * x + R[2, 1] * y + R[2, 2] * z,
        )
        length = far / resolution
        if distance <= far:
            length = distance / resolution + SURFACE_DEPTH
        before = _distance_to_grid(start, direction, shape)
        if before >= length:
            continue
        entry = (
            _inside(start[0] + before * direction[0], shape[0]),
            _inside(start[1] + before * direction[1], shape[1]),
            _inside(start[2] + before * direction[2], shape[2]),
        )
        ray, position = start_ray(entry, direction, shape)
        end = min(length - before, ray.end)
        while position.distance < end:
            count += 1 - mask[position.cell]
            mask[position.cell] = 1
            position = step_ray(ray, position)
    return count
