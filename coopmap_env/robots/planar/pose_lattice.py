"""The configuration space of a planar camera: cell centers times headings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.mapping import VoxelGrid


class LatticeGeometry(NamedTuple):
    """A `PoseLattice` as kernels take it."""

    n_headings: int
    ny: int
    """Cells along y."""
    resolution: float
    """Edge of a cell, metres."""
    origin: tuple[float, float]
    """Lower corner of the grid, metres."""


@dataclass(frozen=True)
class PoseLattice:
    """The discrete points of the configuration space that the paper searches.

    A camera stands at the center of a cell and faces one of `n_headings` directions. A pose has the
    id ``cell * n_headings + heading``; the cell is its flat index in the grid.

    Raises
    ------
    ValueError
        If the grid is not planar, or `n_headings` is not a positive integer.
    """

    grid: VoxelGrid
    n_headings: int = 16
    """Every 22.5 degrees: a third of the default field of view, so neighboring views overlap."""

    def __post_init__(self) -> None:
        if self.grid.dimension != 2:
            raise ValueError(f"PoseLattice needs a planar grid, got {self.grid.shape}")
        if not (isinstance(self.n_headings, int | np.integer) and self.n_headings >= 1):
            raise ValueError(
                f"PoseLattice.n_headings must be an integer >= 1, got {self.n_headings}"
            )

    @property
    def n_poses(self) -> int:
        """Number of poses, free or not."""
        return self.grid.n_cells * self.n_headings

    @cached_property
    def geometry(self) -> LatticeGeometry:
        """The lattice as kernels take it."""
        grid = self.grid
        x0, y0 = grid.origin
        return LatticeGeometry(
            int(self.n_headings), grid.shape[1], float(grid.resolution), (x0, y0)
        )

    def checked_ids(self, ids: ArrayLike) -> NDArray[np.int64]:
        """Pose ids as an array of the same shape; kernels trust them.

        Raises
        ------
        ValueError
            With the first one that is no pose of the lattice, or if they are no integers.
        """
        numbers = np.asarray(ids)
        if numbers.size and numbers.dtype.kind not in "iu":
            raise ValueError(f"pose ids must be integers, got {brief(ids)} of {numbers.dtype}")
        numbers = numbers.astype(np.int64, copy=False)
        if not are_all_below(numbers.ravel(), self.n_poses):
            outside = numbers[(numbers < 0) | (numbers >= self.n_poses)]
            raise ValueError(
                f"pose ids lie in 0 ... {self.n_poses - 1}, those of {self.grid.n_cells} cells "
                f"with {self.n_headings} headings, got {outside[0]}: take them from a belief of "
                "the same environment, such as by feasible_poses"
            )
        return numbers

    def poses(self, ids: ArrayLike) -> NDArray[np.float64]:
        """Poses (..., 3) [x, y, heading in [-pi, pi)], metres and radians, of pose ids."""
        ids = np.asarray(ids, dtype=np.int64)
        out = np.empty((ids.size, 3))
        write_poses(ids.ravel(), tuple(self.geometry), out)
        return out.reshape(*ids.shape, 3)

    def pose(self, pose_id: int) -> tuple[float, float, float]:
        """One pose (x, y, heading) of a pose id; the same bits as `poses`, without its kernel."""
        n, ny, resolution, (x0, y0) = self.geometry
        cell, heading = divmod(int(pose_id), n)
        if 2 * heading >= n:
            heading -= n
        x, y = (cell // ny + 0.5) * resolution + x0, (cell % ny + 0.5) * resolution + y0
        return x, y, heading * (2.0 * math.pi / n)

    def nearest_pose_id(self, pose: tuple[float, float, float]) -> int:
        """Id of the lattice pose nearest to (x, y, heading); -1 if that is outside the grid."""
        return int(nearest_pose_id(*pose, self.grid.shape_3d, tuple(self.geometry)))


@kernel
def are_all_below(numbers: NDArray[np.int64], n: int) -> bool:
    """Whether every number lies in 0 ... n - 1."""
    outside = 0
    for k in range(len(numbers)):
        outside += numbers[k] < 0 or numbers[k] >= n
    return outside == 0


@borrowing_kernel
def cell_center(cell: int, lattice: LatticeGeometry) -> tuple[float, float]:
    """Center of a flat cell, metres."""
    ny, resolution, (x0, y0) = lattice.ny, lattice.resolution, lattice.origin
    return (cell // ny + 0.5) * resolution + x0, (cell % ny + 0.5) * resolution + y0


@borrowing_kernel
def pose_from_id(pose_id: int, lattice: LatticeGeometry) -> tuple[float, float, float]:
    """The pose (x, y, heading) of a pose id; see `PoseLattice.poses`."""
    n_headings = lattice.n_headings
    x, y = cell_center(pose_id // n_headings, lattice)
    heading = pose_id % n_headings
    if 2 * heading >= n_headings:
        heading -= n_headings
    return x, y, heading * (2.0 * math.pi / n_headings)


@kernel
def write_poses(ids: NDArray[np.int64], geometry: PlainTuple, out: NDArray[np.float64]) -> None:
    """Write the poses (k, 3) of ids (k,); `geometry` is a plain `LatticeGeometry`."""
    lattice = LatticeGeometry(*geometry)
    for k in range(len(ids)):
        out[k, 0], out[k, 1], out[k, 2] = pose_from_id(ids[k], lattice)


@kernel
def nearest_pose_id(
    x: float, y: float, heading: float, shape: tuple[int, int, int], geometry: PlainTuple
) -> int:
    """See `PoseLattice.nearest_pose_id`; `geometry` is a plain `LatticeGeometry`."""
    lattice = LatticeGeometry(*geometry)
    n, (nx, ny, _), (x0, y0) = lattice.n_headings, shape, lattice.origin
    ix, iy = math.floor((x - x0) / lattice.resolution), math.floor((y - y0) / lattice.resolution)
    if not (0 <= ix < nx and 0 <= iy < ny):
        return -1
    heading_number = int(np.rint(heading * n / (2.0 * math.pi))) % n
    return (ix * ny + iy) * n + heading_number
