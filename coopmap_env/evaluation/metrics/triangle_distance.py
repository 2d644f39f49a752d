"""Exact distances of points to triangles, by bins of triangles.

Each bin of a uniform grid lists the triangles whose box along the axes touches it. A point asks
its own bin, then the bins around it, ring by ring, until no further ring can hold anything nearer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.evaluation.metrics.surface_samples import clip_triangles
from coopmap_env.mapping import VoxelGrid


@dataclass(frozen=True, eq=False)
class TriangleBins:
    """The triangles inside of a grid, found by place."""

    triangles: NDArray[np.float64]
    """Shape (m, 3, 3), metres, cut off at the grid's sides."""
    grid: VoxelGrid
    """Its cells are the bins."""
    bin_starts: NDArray[np.int64]
    """Shape (n_cells + 1,): where in `bin_triangles` each bin begins."""
    bin_triangles: NDArray[np.int32]
    """Triangles, bin by bin."""

    @classmethod
    def from_triangles(cls, triangles: ArrayLike, grid: VoxelGrid) -> TriangleBins:
        """Sort what of the triangles (m, 3, 3) lies inside of a 3-D grid into bins."""
        if grid.dimension != 3:
            raise ValueError(f"triangles need a grid of 3 axes, got {grid.shape}")
        inside = np.ascontiguousarray(clip_triangles(triangles, grid)[0])
        size = np.array(grid.shape)
        # a box that ends on the border of two bins is in both, whatever the rounding
        first = np.clip(np.floor(grid.to_cell_units(inside.min(axis=1)) - 1e-9), 0, size - 1)
        last = np.clip(np.floor(grid.to_cell_units(inside.max(axis=1)) + 1e-9), 0, size - 1)
        boxes = np.stack([first, last], axis=1).astype(np.int64)
        bin_starts = np.zeros(grid.n_cells + 1, dtype=np.int64)
        count_triangles_per_bin(boxes, size, bin_starts)
        np.cumsum(bin_starts, out=bin_starts)
        bin_triangles = np.empty(bin_starts[-1], dtype=np.int32)
        fill_bins(boxes, size, bin_starts[:-1].copy(), bin_triangles)
        return cls(inside, grid, bin_starts, bin_triangles)

    def distances(self, points: ArrayLike) -> NDArray[np.float64]:
        """Metres (n,) from points (n, 3) to the nearest triangle; inf if there is none."""
        positions = np.ascontiguousarray(points, dtype=np.float64)
        if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
            raise ValueError(f"points must be (n, 3) and finite, got shape {positions.shape}")
        out = np.full(len(positions), np.inf)
        if len(self.triangles):
            nearest_distances(
                positions, self.triangles, np.array(self.grid.origin), self.grid.resolution,
                np.array(self.grid.shape), self.bin_starts, self.bin_triangles, out,
            )  # fmt: skip
        return out


@njit(cache=True, nogil=True)
def count_triangles_per_bin(boxes, size, counts):
    """Count the triangles of each bin b in counts[b + 1]."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * size[1] + j) * size[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    counts[row + k + 1] += 1


@njit(cache=True, nogil=True)
def fill_bins(boxes, size, next_slots, bin_triangles):
    """Write each triangle to its bins; `next_slots` (n_cells,) is the next free one of each bin."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * size[1] + j) * size[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    bin_triangles[next_slots[row + k]] = m
                    next_slots[row + k] += 1


@njit(cache=True, nogil=True)
def nearest_distances(points, triangles, lower, resolution, size, bin_starts, bin_triangles, out):
    """Distance of each point (n, 3) to the nearest triangle: out (n,)."""
    home_bin = np.empty(3, np.int64)
    n_rings = max(size[0], size[1], size[2])
    for n in range(len(points)):
        p = points[n]
        for axis in range(3):
            coordinate = np.floor((p[axis] - lower[axis]) / resolution)
            home_bin[axis] = int(min(max(coordinate, 0.0), size[axis] - 1.0))
        best = np.inf
        for ring in range(n_rings):
            # what lies beyond the rings so far is at least this far away
            min_distance = max(ring - 1, 0) * resolution
            if best <= min_distance * min_distance:
                break
            best = nearest_in_ring(
                p, home_bin, ring, triangles, size, bin_starts, bin_triangles, best
            )
        out[n] = np.sqrt(best)


@njit(cache=True, nogil=True)
def nearest_in_ring(p, home_bin, ring, triangles, size, bin_starts, bin_triangles, best):
    """Least squared distance: `best`, or that of a triangle `ring` bins away from `home_bin`."""
    for i in range(max(home_bin[0] - ring, 0), min(home_bin[0] + ring, size[0] - 1) + 1):
        for j in range(max(home_bin[1] - ring, 0), min(home_bin[1] + ring, size[1] - 1) + 1):
            on_side = abs(i - home_bin[0]) == ring or abs(j - home_bin[1]) == ring
            row = (i * size[1] + j) * size[2]
            step = 1 if on_side else max(2 * ring, 1)  # inside, only the ring's top and bottom
            for k in range(home_bin[2] - ring, home_bin[2] + ring + 1, step):
                if 0 <= k < size[2]:
                    for m in range(bin_starts[row + k], bin_starts[row + k + 1]):
                        best = min(best, squared_distance(p, triangles[bin_triangles[m]]))
    return best


@njit(cache=True, nogil=True)
def squared_distance(p, triangle):
    """Squared distance of a point (3,) to a triangle (3, 3), which may be a line or a point.

    To its plane if the point lies over the triangle, else to the nearest edge.
    """
    a, b, c = triangle[0], triangle[1], triangle[2]
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    squared_normal = nx * nx + ny * ny + nz * nz
    projects_inside, best, longest, height = True, np.inf, 0.0, 0.0
    for k in range(3):
        a = triangle[k]
        b = triangle[(k + 1) % 3]
        ex, ey, ez = b[0] - a[0], b[1] - a[1], b[2] - a[2]
        dx, dy, dz = p[0] - a[0], p[1] - a[1], p[2] - a[2]
        length = ex * ex + ey * ey + ez * ez
        longest = max(longest, length)
        along = ex * dx + ey * dy + ez * dz
        fraction = min(max(along / length, 0.0), 1.0) if length > 0.0 else 0.0
        rx, ry, rz = dx - fraction * ex, dy - fraction * ey, dz - fraction * ez
        best = min(best, rx * rx + ry * ry + rz * rz)
        # on which side of this edge, looking along the normal
        projects_inside &= (
            nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx) >= 0.0
        )
        height = nx * dx + ny * dy + nz * dz
    # of a triangle next to a line, rounding makes the normal: its edges say all
    if projects_inside and squared_normal > 1e-20 * longest * longest:
        best = min(best, height * height / squared_normal)
    return best
