"""The configuration space of a planar camera: cell centres times headings."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
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

    def poses(self, ids: ArrayLike) -> NDArray[np.float64]:
        """Poses (..., 3) [x, y, heading in [-pi, pi)], metres and radians, of pose numbers."""
        ids = np.asarray(ids)
        cell, heading = np.divmod(ids, self.n_headings)
        ix, iy = np.divmod(cell, self.grid.shape[1])
        resolution, (x0, y0) = self.grid.resolution, self.grid.origin
        heading = np.where(2 * heading < self.n_headings, heading, heading - self.n_headings)
        out = np.empty((*ids.shape, 3))
        out[..., 0] = (ix + 0.5) * resolution + x0
        out[..., 1] = (iy + 0.5) * resolution + y0
        out[..., 2] = heading * (2 * math.pi / self.n_headings)
        return out

    def pose(self, pose_id: int) -> tuple[float, float, float]:
        """One pose (x, y, heading) of a pose number; as `poses`, without arrays."""
        cell, heading = divmod(pose_id, self.n_headings)
        ix, iy = divmod(cell, self.grid.shape[1])
        resolution, (x0, y0) = self.grid.resolution, self.grid.origin
        if 2 * heading >= self.n_headings:
            heading -= self.n_headings
        return (
            (ix + 0.5) * resolution + x0,
            (iy + 0.5) * resolution + y0,
            heading * (2 * math.pi / self.n_headings),
        )

    def nearest(self, pose: tuple[float, float, float]) -> int:
        """Number of the lattice pose nearest to (x, y, heading), -1 if that is outside the grid."""
        x, y, heading = pose
        (nx, ny), resolution, (x0, y0) = self.grid.shape, self.grid.resolution, self.grid.origin
        ix, iy = math.floor((x - x0) / resolution), math.floor((y - y0) / resolution)
        if not (0 <= ix < nx and 0 <= iy < ny):
            return -1
        turn = round(heading * self.n_headings / (2 * math.pi)) % self.n_headings
        return int((ix * ny + iy) * self.n_headings + turn)
