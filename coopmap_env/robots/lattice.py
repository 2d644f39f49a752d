"""The configuration space of a planar camera: cell centres times headings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.mapping import VoxelGrid


@dataclass(frozen=True)
class PoseLattice:
    """The discrete points of the configuration space that the paper searches.

    A camera stands at the centre of a cell and looks in one of `n_headings` directions; a pose is
    numbered `cell * n_headings + heading`, the cell being its flat number in the grid.
    """

    grid: VoxelGrid
    n_headings: int = 16
    """Every 22.5 degrees: a third of the default field of view, so neighbouring views overlap."""

    def __post_init__(self) -> None:
        if self.grid.dimension != 2:
            raise ValueError(f"PoseLattice needs a planar grid, got {self.grid.shape}")
        if not (isinstance(self.n_headings, int | np.integer) and self.n_headings >= 1):
            raise ValueError(
                f"PoseLattice.n_headings must be a whole number of at least 1, got "
                f"{self.n_headings}"
            )

    @property
    def n_poses(self) -> int:
        """Number of poses, free or not."""
        return self.grid.n_cells * self.n_headings

    @cached_property
    def kernel_layout(self) -> tuple[int, int, float, tuple[float, ...]]:
        """As kernels want it: headings, cells along y, resolution, origin."""
        grid = self.grid
        return int(self.n_headings), grid.shape[1], float(grid.resolution), grid.origin

    def poses(self, ids: ArrayLike) -> NDArray[np.float64]:
        """Poses (..., 3) [x, y, heading in [-pi, pi)], metres and radians, of pose numbers."""
        ids = np.asarray(ids, dtype=np.int64)
        out = np.empty((ids.size, 3))
        write_poses(ids.ravel(), self.kernel_layout, out)
        return out.reshape(*ids.shape, 3)

    def pose(self, pose_id: int) -> tuple[float, float, float]:
        """One pose (x, y, heading) of a pose number; as `poses`, without arrays."""
        x, y, heading = pose_from_id(pose_id, self.kernel_layout)
        return x, y, heading

    def cells_within(
        self, cells: NDArray[np.int32], pose_id: int, half_width: float
    ) -> NDArray[np.int32]:
        """Those of some cells at most `half_width` metres ahead of a pose or back, and to a side.

        A cell counts if its centre does, but for the rounding of the rotation.
        """
        out = np.empty_like(cells)
        return out[
            : write_cells_within(cells, pose_id, half_width * (1 + 1e-9), self.kernel_layout, out)
        ]

    def nearest_pose_id(self, pose: tuple[float, float, float]) -> int:
        """Number of the lattice pose nearest to (x, y, heading), -1 if that is outside the grid."""
        x, y, heading = pose
        (nx, ny), resolution, (x0, y0) = self.grid.shape, self.grid.resolution, self.grid.origin
        ix, iy = math.floor((x - x0) / resolution), math.floor((y - y0) / resolution)
        if not (0 <= ix < nx and 0 <= iy < ny):
            return -1
        heading_index = round(heading * self.n_headings / (2 * math.pi)) % self.n_headings
        return int((ix * ny + iy) * self.n_headings + heading_index)


@njit(cache=True, nogil=True)
def cell_center(cell, layout):
    """Where the centre of a flat cell is, metres."""
    _, ny, resolution, (x0, y0) = layout
    return (cell // ny + 0.5) * resolution + x0, (cell % ny + 0.5) * resolution + y0


@njit(cache=True, nogil=True)
def pose_from_id(pose_id, layout):
    """The pose (x, y, heading) of a pose number; see `PoseLattice.poses`."""
    n_headings = layout[0]
    x, y = cell_center(pose_id // n_headings, layout)
    heading = pose_id % n_headings
    if 2 * heading >= n_headings:
        heading -= n_headings
    return x, y, heading * (2.0 * math.pi / n_headings)


@njit(cache=True, nogil=True)
def write_poses(ids, layout, out):
    """Write the poses (k, 3) of numbers (k,)."""
    for k in range(len(ids)):
        out[k, 0], out[k, 1], out[k, 2] = pose_from_id(ids[k], layout)


@njit(cache=True, nogil=True)
def write_cells_within(cells, pose_id, half_width, layout, out):
    """Write the cells of `PoseLattice.cells_within` in their order; return how many they are."""
    x, y, heading = pose_from_id(pose_id, layout)
    c, s = math.cos(heading), math.sin(heading)
    count = 0
    for cell in cells:
        cell_x, cell_y = cell_center(cell, layout)
        dx, dy = cell_x - x, cell_y - y
        out[count] = cell  # the next one is written over it unless it is within
        count += abs(c * dx + s * dy) <= half_width and abs(c * dy - s * dx) <= half_width
    return count
