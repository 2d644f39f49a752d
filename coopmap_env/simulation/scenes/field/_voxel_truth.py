"""True occupancy of voxels: those that a surface intersects, and those inside of closed solids.

Surface: a triangle and a voxel, both convex, are apart if and only if they are apart along one of
13 axes: the voxel's three normals, the triangle's normal, and the nine cross products of an edge
of one and an edge of the other (Akenine-Moeller 2001, "Fast 3D triangle-box overlap testing").
A voxel that is merely touched counts.

Inside: each connected region of the other voxels lies wholly inside or wholly outside, as no
surface passes through it. The winding number at one point of it decides: that of a closed surface
is 0 exactly outside.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.mapping import VoxelGrid

if TYPE_CHECKING:
    from coopmap_env.simulation.scenes.field.solid import Solid

TOUCH_TOLERANCE = 1e-9
"""Cells by which a voxel is enlarged, so that rounding does not separate what touches."""


def voxelize_solids(solids: "Sequence[Solid]", grid: VoxelGrid) -> NDArray[np.bool_]:
    """Mask (nx, ny, nz) of the voxels that solids occupy."""
    occupied = np.zeros(grid.shape, dtype=np.bool_)
    for solid in solids:
        low, high = grid.to_cell_units(solid.bounds)
        first = np.maximum(np.ceil(low - 1.0 - TOUCH_TOLERANCE), 0).astype(np.int64)
        last = np.minimum(
            np.floor(high + TOUCH_TOLERANCE).astype(np.int64), np.subtract(grid.shape, 1)
        )
        if (first > last).any():
            continue
        triangles = grid.to_cell_units(solid.triangles) - first
        own = np.zeros(tuple(last - first + 1), dtype=np.bool_)
        mark_surface_voxels(np.ascontiguousarray(triangles), own)
        if is_closed(solid.faces):
            _fill_interior(triangles, own)
        occupied[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] |= own
    return occupied


def is_closed(faces: NDArray[np.int64]) -> bool:
    """Whether a surface has no border: each edge occurs equally often in both directions.

    Faces (f, 3) name vertices; a corner that is stored twice counts as a border.
    """
    edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    size = int(faces.max()) + 1
    forth = np.sort(edges[:, 0] * size + edges[:, 1])
    back = np.sort(edges[:, 1] * size + edges[:, 0])
    return bool((forth == back).all())


def winding_numbers(
    triangles: NDArray[np.float64], points: NDArray[np.float64]
) -> NDArray[np.float64]:
    """How often the triangles (m, 3, 3) wind around each of the points (p, 3).

    Sum of the signed solid angles over 4 pi (Van Oosterom & Strackee 1983); 1 inside of a closed
    surface whose faces are anticlockwise from outside, 0 outside.
    """
    a, b, c = np.moveaxis(triangles - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(corner, axis=-1) for corner in (a, b, c))
    volume = (a * np.cross(b, c)).sum(axis=-1)
    scale = la * lb * lc
    for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
        scale = scale + (one * two).sum(axis=-1) * length
    return np.arctan2(volume, scale).sum(axis=1) / (2.0 * np.pi)


def _fill_interior(triangles: NDArray[np.float64], own: NDArray[np.bool_]) -> None:
    """Mark the regions inside of a closed surface; `triangles` are in cells."""
    from scipy import ndimage  # only where a solid has an inside

    if own.all():
        return
    regions, n_regions = ndimage.label(~own)
    _, first = np.unique(regions, return_index=True)
    first = first[-n_regions:]  # region 0 is the surface
    points = np.stack(np.unravel_index(first, own.shape), axis=-1) + 0.5
    inside = np.zeros(n_regions + 1, dtype=np.bool_)
    for k, point in enumerate(points):
        inside[k + 1] = abs(winding_numbers(triangles, point[None])[0]) > 0.5
    own |= inside[regions]


@kernel
def mark_surface_voxels(triangles: NDArray[np.float64], occupied: NDArray[np.bool_]) -> None:
    """Mark the cells of `occupied` (nx, ny, nz) that triangles (m, 3, 3) in cells intersect."""
    half = 0.5 + TOUCH_TOLERANCE
    size = occupied.shape
    low, high = np.empty(3, np.int64), np.empty(3, np.int64)
    corners = np.empty((3, 3))
    for m in range(len(triangles)):
        triangle = triangles[m]
        for k in range(3):
            least = min(triangle[0, k], triangle[1, k], triangle[2, k])
            most = max(triangle[0, k], triangle[1, k], triangle[2, k])
            # Clipped while still floats: a corner may lie further out than an int64 counts.
            low[k] = int(np.ceil(min(max(least - 1.0 - TOUCH_TOLERANCE, 0.0), float(size[k]))))
            high[k] = int(np.floor(max(min(most + TOUCH_TOLERANCE, size[k] - 1.0), -1.0)))
        for x in range(low[0], high[0] + 1):
            for y in range(low[1], high[1] + 1):
                for z in range(low[2], high[2] + 1):
                    if occupied[x, y, z]:
                        continue
                    for k in range(3):
                        corners[k, 0] = triangle[k, 0] - x - 0.5
                        corners[k, 1] = triangle[k, 1] - y - 0.5
                        corners[k, 2] = triangle[k, 2] - z - 0.5
                    occupied[x, y, z] = overlaps_cube(corners, half)


@kernel
def overlaps_cube(corners: NDArray[np.float64], half: float) -> bool:
    """Whether a triangle (3, 3) intersects the cube of this half edge about 0.

    The caller's bounds have decided on the cube's own three normals.
    """
    for k in range(3):
        after = (k + 1) % 3
        ex = corners[after, 0] - corners[k, 0]
        ey = corners[after, 1] - corners[k, 1]
        ez = corners[after, 2] - corners[k, 2]
        if (
            is_separating_axis(corners, half, 0.0, -ez, ey)
            or is_separating_axis(corners, half, ez, 0.0, -ex)
            or is_separating_axis(corners, half, -ey, ex, 0.0)
        ):
            return False
    ux, vx = corners[1, 0] - corners[0, 0], corners[2, 0] - corners[0, 0]
    uy, vy = corners[1, 1] - corners[0, 1], corners[2, 1] - corners[0, 1]
    uz, vz = corners[1, 2] - corners[0, 2], corners[2, 2] - corners[0, 2]
    return not is_separating_axis(
        corners, half, uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    )


@inlined_kernel
def is_separating_axis(
    corners: NDArray[np.float64], half: float, x: float, y: float, z: float
) -> bool:
    """Whether the axis (x, y, z) separates the triangle from the cube; a zero axis never does."""
    a = corners[0, 0] * x + corners[0, 1] * y + corners[0, 2] * z
    b = corners[1, 0] * x + corners[1, 1] * y + corners[1, 2] * z
    c = corners[2, 0] * x + corners[2, 1] * y + corners[2, 2] * z
    reach = half * (abs(x) + abs(y) + abs(z))
    return min(a, b, c) > reach or max(a, b, c) < -reach
