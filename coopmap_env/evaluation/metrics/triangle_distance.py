"""Exact distances of points to triangles, by bins of triangles.

Each bin of a uniform grid lists the triangles whose box along the axes touches it. A point asks
its own bin, then the bins around it, ring by ring, until no further ring can hold anything nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.metrics.surface_samples import triangles_in_grid
from coopmap_env.mapping import VoxelGrid


@dataclass(frozen=True, eq=False)
class TriangleBins:
    """The triangles inside of a grid, found by place."""

    triangles: NDArray[np.float64]
    """Shape (m, 3, 3), metres, cut off at the grid's sides."""
    grid: VoxelGrid
    """Its cells are the bins."""
    begins: NDArray[np.int64]
    """Shape (n_cells + 1,): where in `members` each bin begins."""
    members: NDArray[np.int32]
    """Triangles, bin by bin."""

    @classmethod
    def of(cls, triangles: ArrayLike, grid: VoxelGrid) -> TriangleBins:
        """Sort what of the triangles (m, 3, 3) lies inside of a 3-D grid into bins."""
        if grid.dimension != 3:
            raise ValueError(f"triangles need a grid of 3 axes, got {grid.shape}")
        inside = np.ascontiguousarray(triangles_in_grid(triangles, grid)[0])
        size = np.array(grid.shape)
        # a box that ends on the border of two bins is in both, whatever the rounding
        first = np.clip(np.floor(grid.to_cell_units(inside.min(axis=1)) - 1e-9), 0, size - 1)
        last = np.clip(np.floor(grid.to_cell_units(inside.max(axis=1)) + 1e-9), 0, size - 1)
        boxes = np.stack([first, last], axis=1).astype(np.int64)
        begins = np.zeros(grid.n_cells + 1, dtype=np.int64)
        count_members(boxes, size, begins)
        np.cumsum(begins, out=begins)
        members = np.empty(begins[-1], dtype=np.int32)
        list_members(boxes, size, begins[:-1].copy(), members)
        return cls(inside, grid, begins, members)

    def distances(self, points: ArrayLike) -> NDArray[np.float64]:
        """Metres (n,) from points (n, 3) to the nearest triangle; inf if there is none."""
        at = np.ascontiguousarray(points, dtype=np.float64)
        if at.ndim != 2 or at.shape[1] != 3 or not np.isfinite(at).all():
            raise ValueError(f"points must be (n, 3) and finite, got shape {at.shape}")
        out = np.full(len(at), np.inf)
        if len(self.triangles):
            nearest_distances(
                at, self.triangles, np.array(self.grid.origin), self.grid.resolution,
                np.array(self.grid.shape), self.begins, self.members, out,
            )  # fmt: skip
        return out


@njit(cache=True, nogil=True)
def count_members(boxes, size, counts):
    """Count the triangles of each bin b in counts[b + 1]."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * size[1] + j) * size[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    counts[row + k + 1] += 1


@njit(cache=True, nogil=True)
def list_members(boxes, size, places, members):
    """Write each triangle to its bins; `places` (n_cells,) is the next free one of each bin."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * size[1] + j) * size[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    members[places[row + k]] = m
                    places[row + k] += 1


@njit(cache=True, nogil=True)
def nearest_distances(points, triangles, lower, resolution, size, begins, members, out):
    """Distance of each point (n, 3) to the nearest triangle: out (n,)."""
    home = np.empty(3, np.int64)
    rings = max(size[0], size[1], size[2])
    for n in range(len(points)):
        p = points[n]
        for axis in range(3):
            place = np.floor((p[axis] - lower[axis]) / resolution)
            home[axis] = int(min(max(place, 0.0), size[axis] - 1.0))
        best = np.inf
        for ring in range(rings):
            # what lies beyond the rings so far is at least this far away
            beyond = max(ring - 1, 0) * resolution
            if best <= beyond * beyond:
                break
            best = nearest_in_ring(p, home, ring, triangles, size, begins, members, best)
        out[n] = np.sqrt(best)


@njit(cache=True, nogil=True)
def nearest_in_ring(p, home, ring, triangles, size, begins, members, best):
    """Least squared distance: `best`, or that of a triangle `ring` bins away from `home`."""
    for i in range(max(home[0] - ring, 0), min(home[0] + ring, size[0] - 1) + 1):
        for j in range(max(home[1] - ring, 0), min(home[1] + ring, size[1] - 1) + 1):
            on_side = abs(i - home[0]) == ring or abs(j - home[1]) == ring
            row = (i * size[1] + j) * size[2]
            step = 1 if on_side else max(2 * ring, 1)  # inside, only the ring's top and bottom
            for k in range(home[2] - ring, home[2] + ring + 1, step):
                if 0 <= k < size[2]:
                    for m in range(begins[row + k], begins[row + k + 1]):
                        best = min(best, square_distance(p, triangles[members[m]]))
    return best


@njit(cache=True, nogil=True)
def square_distance(p, triangle):
    """Squared distance of a point (3,) to a triangle (3, 3), which may be a line or a point.

    To its plane if the point lies over the triangle, else to the nearest edge.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    square = nx * nx + ny * ny + nz * nz
    over, best, longest, height = True, np.inf, 0.0, 0.0
    for k in range(3):
        a = triangle[k]
        b = triangle[(k + 1) % 3]
        ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        dx, dy, dz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
        length = ex * ex + ey * ey + ez * ez
        longest = max(longest, length)
        along = ex * dx + ey * dy + ez * dz
        share = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
        rx, ry, rz = dx - share * ex, dy - share * ey, dz - share * ez
        best = min(best, rx * rx + ry * ry + rz * rz)
        # on which side of this edge, looking along the normal
        over &= (
            nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx) >= 0.0
        )
        height = nx * dx + ny * dy + nz * dz
    # of a triangle next to a line, rounding makes the normal: its edges say all
    if over and square > 1e-20 * longest * longest:
        best = min(best, height * height / square)
    return best
