"""Exact distances of points to triangles, with a grid of bins as the spatial index.

Each bin of a uniform grid lists the triangles whose axis-aligned box overlaps it. A query searches
the point's own bin, then the bins around it, ring by ring, until no further ring can hold a nearer
triangle.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.evaluation.metrics._surface_samples import clip_triangles
from coopmap_env.mapping import GridGeometry, VoxelGrid


class TriangleIndex(NamedTuple):
    """`TriangleBins` as kernels take it."""

    triangles: NDArray[np.float64]
    """Corners (m, 3, 3), metres."""
    grid: GridGeometry
    """Its cells are the bins."""
    bin_starts: NDArray[np.int64]
    """Where in `bin_triangles` each bin begins (n_cells + 1,)."""
    bin_triangles: NDArray[np.int32]
    """Triangles by number, bin by bin."""


@dataclass(frozen=True, eq=False)
class TriangleBins:
    """The triangles inside a grid, sorted into its cells."""

    triangles: NDArray[np.float64]
    """Shape (m, 3, 3), metres, clipped at the grid's sides."""
    grid: VoxelGrid
    """Its cells are the bins."""
    bin_starts: NDArray[np.int64]
    """Shape (n_cells + 1,): where in `bin_triangles` each bin begins."""
    bin_triangles: NDArray[np.int32]
    """Triangles by number, bin by bin."""

    @classmethod
    def from_triangles(cls, triangles: ArrayLike, grid: VoxelGrid) -> TriangleBins:
        """Clip triangles (m, 3, 3) to a 3-D grid and sort them into bins.

        Raises
        ------
        ValueError
            If the grid is planar.
        """
        if grid.dimension != 3:
            raise ValueError(f"triangles need a grid of 3 axes, got {grid.shape}")
        inside = np.ascontiguousarray(clip_triangles(triangles, grid)[0])
        size = np.array(grid.shape)
        # a box that ends on the border of two bins is in both, whatever the rounding
        first = np.clip(np.floor(grid.to_cell_units(inside.min(axis=1)) - 1e-9), 0, size - 1)
        last = np.clip(np.floor(grid.to_cell_units(inside.max(axis=1)) + 1e-9), 0, size - 1)
        boxes = np.stack([first, last], axis=1).astype(np.int64)
        bin_starts = np.zeros(grid.n_cells + 1, dtype=np.int64)
        count_triangles_per_bin(boxes, grid.geometry.shape, bin_starts)
        np.cumsum(bin_starts, out=bin_starts)
        bin_triangles = np.empty(bin_starts[-1], dtype=np.int32)
        fill_bins(boxes, grid.geometry.shape, bin_starts[:-1].copy(), bin_triangles)
        return cls(inside, grid, bin_starts, bin_triangles)

    @cached_property
    def index(self) -> TriangleIndex:
        """The same for kernels."""
        return TriangleIndex(
            self.triangles, self.grid.geometry, self.bin_starts, self.bin_triangles
        )

    def distances(self, points: ArrayLike) -> NDArray[np.float64]:
        """Metres (n,) from points (n, 3) to the nearest triangle; infinite if there is none.

        Raises
        ------
        ValueError
            If the points have another shape, or one is not finite.
        """
        positions = _as_points(points)
        out = np.full(len(positions), np.inf)
        if len(self.triangles):
            nearest_distances(positions, self.index, out, np.empty_like(positions))
        return out

    def offsets(self, points: ArrayLike) -> NDArray[np.float64]:
        """Metres (n, 3) from points (n, 3) to the nearest points of the triangles.

        Raises
        ------
        ValueError
            As in `distances`, or if there are no triangles.
        """
        positions = _as_points(points)
        if not len(self.triangles):
            raise ValueError(f"there are no triangles inside the grid {self.grid} to lead to")
        offsets = np.empty_like(positions)
        nearest_distances(positions, self.index, np.empty(len(positions)), offsets)
        return offsets


def surface_offsets(
    points: ArrayLike, triangles: ArrayLike, grid: VoxelGrid
) -> NDArray[np.float64]:
    """Metres (n, 3) from points (n, 3) to the nearest points of triangles inside a 3-D grid.

    Raises
    ------
    ValueError
        If the grid is planar, the points are not (n, 3) and finite, or no triangle is inside.
    """
    return TriangleBins.from_triangles(triangles, grid).offsets(points)


def _as_points(points: ArrayLike) -> NDArray[np.float64]:
    positions = np.ascontiguousarray(points, dtype=np.float64)
    if positions.ndim != 2 or positions.shape[1] != 3:
        raise ValueError(f"points must be (n, 3), got shape {positions.shape}")
    finite = np.isfinite(positions).all(axis=1)
    if not finite.all():
        first = int(np.argmin(finite))
        raise ValueError(f"points must be finite, got {positions[first].tolist()} at {first}")
    return positions


@kernel
def count_triangles_per_bin(
    boxes: NDArray[np.int64], shape: tuple[int, int, int], counts: NDArray[np.int64]
) -> None:
    """Count the triangles of each bin b in counts[b + 1]; boxes (m, 2, 3) of bins, inclusive."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * shape[1] + j) * shape[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    counts[row + k + 1] += 1


@kernel
def fill_bins(
    boxes: NDArray[np.int64],
    shape: tuple[int, int, int],
    next_slots: NDArray[np.int64],
    bin_triangles: NDArray[np.int32],
) -> None:
    """Write each triangle into its bins; `next_slots` (n_cells,) are the next free slots."""
    for m in range(len(boxes)):
        for i in range(boxes[m, 0, 0], boxes[m, 1, 0] + 1):
            for j in range(boxes[m, 0, 1], boxes[m, 1, 1] + 1):
                row = (i * shape[1] + j) * shape[2]
                for k in range(boxes[m, 0, 2], boxes[m, 1, 2] + 1):
                    bin_triangles[next_slots[row + k]] = m
                    next_slots[row + k] += 1


@kernel
def nearest_distances(
    points: NDArray[np.float64],
    index: TriangleIndex,
    out: NDArray[np.float64],
    offsets: NDArray[np.float64],
) -> None:
    """Distance of each point (n, 3) to the nearest triangle: out (n,); the way there: (n, 3)."""
    way = np.empty(3)
    home_bin = np.empty(3, np.int64)
    shape = index.grid.shape
    n_rings = max(shape[0], shape[1], shape[2])
    for n in range(len(points)):
        p = points[n]
        for axis in range(3):
            coordinate = np.floor((p[axis] - index.grid.lower[axis]) / index.grid.resolution)
            home_bin[axis] = int(min(max(coordinate, 0.0), shape[axis] - 1.0))
        best = np.inf
        for ring in range(n_rings):
            # triangles of this ring and the further ones are at least this far away
            min_distance = max(ring - 1, 0) * index.grid.resolution
            if best <= min_distance * min_distance:
                break
            best = nearest_in_ring(p, home_bin, ring, index, best, way, offsets[n])
        out[n] = np.sqrt(best)


@kernel
def nearest_in_ring(
    p: NDArray[np.float64],
    home_bin: NDArray[np.int64],
    ring: int,
    index: TriangleIndex,
    best: float,
    way: NDArray[np.float64],
    offset: NDArray[np.float64],
) -> float:
    """Least squared distance: `best`, or that of a triangle `ring` bins away from `home_bin`.

    Then the way there is written to `offset` (3,); `way` (3,) is a buffer.
    """
    shape = index.grid.shape
    for i in range(max(home_bin[0] - ring, 0), min(home_bin[0] + ring, shape[0] - 1) + 1):
        for j in range(max(home_bin[1] - ring, 0), min(home_bin[1] + ring, shape[1] - 1) + 1):
            on_side = abs(i - home_bin[0]) == ring or abs(j - home_bin[1]) == ring
            row = (i * shape[1] + j) * shape[2]
            step = 1 if on_side else max(2 * ring, 1)  # inside, only the ring's top and bottom
            for k in range(home_bin[2] - ring, home_bin[2] + ring + 1, step):
                if 0 <= k < shape[2]:
                    for slot in range(index.bin_starts[row + k], index.bin_starts[row + k + 1]):
                        triangle = index.triangles[index.bin_triangles[slot]]
                        square = squared_distance(p, triangle, way)
                        if square < best:
                            best = square
                            offset[:] = way
    return best


@kernel
def squared_distance(
    p: NDArray[np.float64], triangle: NDArray[np.float64], way: NDArray[np.float64]
) -> float:
    """Squared distance of a point (3,) to a triangle (3, 3), which may be a line or a point.

    That to its plane if the point projects into the triangle, otherwise that to the nearest edge.
    Writes the way from the point to the nearest one of the triangle (3,).
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
        square = rx * rx + ry * ry + rz * rz
        if square < best:
            best = square
            way[0], way[1], way[2] = -rx, -ry, -rz
        # the side of this edge, seen along the normal
        projects_inside &= (
            nx * (ey * dz - ez * dy) + ny * (ez * dx - ex * dz) + nz * (ex * dy - ey * dx) >= 0.0
        )
        height = nx * dx + ny * dy + nz * dz
    # the normal of a triangle that is almost a line is rounding: its edges decide
    if projects_inside and squared_normal > 1e-20 * longest * longest:
        square = height * height / squared_normal
        if square < best:
            best = square
            fraction = -height / squared_normal
            way[0], way[1], way[2] = fraction * nx, fraction * ny, fraction * nz
    return best
