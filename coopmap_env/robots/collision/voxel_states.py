"""Which voxels around a robot are known to be free, and what the others are, in 3-D.

A voxel is free if it was sampled and P < 0.05, as in 2-D; all others, and all beyond the map, are
blocked. A sphere is free if it touches no blocked voxel. The voxels themselves are tested: the test
is exact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.core.limits import check_cells
from coopmap_env.mapping import FREE_LOG_ODDS_FIXED, MapArrays, OccupancyMap, VoxelGrid

FREE, UNKNOWN, OCCUPIED, OUTSIDE = range(4)
STATE_NAMES = ("free space", "unknown space", "an obstacle", "the edge of the map")
"""Names of the voxel states."""


@dataclass(frozen=True, eq=False)
class VoxelStates:
    """The states of the voxels in a box around a robot, at one time."""

    states: NDArray[np.uint8]
    """Shape (nx, ny, nz): `FREE`, `UNKNOWN`, `OCCUPIED` or `OUTSIDE` of the map."""
    lower: NDArray[np.float64]
    """Shape (3,): the box's lower corner, metres, in the world frame."""
    resolution: float

    @classmethod
    def from_map(cls, map_: OccupancyMap, center: ArrayLike, reach: float) -> VoxelStates:
        """Voxel states of a map in the box that extends `reach` metres around a point.

        Raises
        ------
        ValueError
            If the map is not 3-D, or a value of the box is out of its range.
        """
        grid = map_.grid
        first, shape = box_around(grid, center, reach)
        states = np.empty(shape, dtype=np.uint8)
        copy_states(map_.arrays, first, states)
        lower = np.array(grid.origin) + first * grid.resolution
        return cls(states, lower, grid.resolution)

    def sphere_states(self, centers: ArrayLike, radii: ArrayLike) -> NDArray[np.uint8]:
        """The worst state (...,) of the voxels that spheres touch; `FREE` if they are free.

        Parameters
        ----------
        centers : array_like, shape (..., 3)
            World frame, metres.
        radii : array_like, broadcast to (...,)
        """
        centers = np.asarray(centers, dtype=np.float64)
        out = np.empty(centers.shape[:-1], dtype=np.uint8)
        flat = np.ascontiguousarray(centers.reshape(-1, 3))
        wide = np.ascontiguousarray(np.broadcast_to(radii, out.shape).ravel(), dtype=np.float64)
        sphere_states(self.states, self.lower, self.resolution, flat, wide, out.reshape(-1))
        return out


def box_around(
    grid: VoxelGrid, center: ArrayLike, reach: float
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The box of voxels that extends `reach` metres around a point: its first index and shape (3,).

    Raises
    ------
    ValueError
        If the grid is not 3-D, or a value of the box is out of its range.
    """
    if grid.dimension != 3:
        raise ValueError(f"a mount needs a 3-D map, got the grid {grid.shape}")
    middle = np.asarray(center, dtype=np.float64)
    if middle.shape != (3,) or not np.isfinite(middle).all():
        raise ValueError(f"the box's center must be three finite values, got {middle}")
    if not (np.isfinite(reach) and reach > 0):
        raise ValueError(f"the box's reach must be finite and > 0, got {reach}")
    first = np.floor(grid.to_cell_units(middle - reach)).astype(np.int64)
    shape = np.floor(grid.to_cell_units(middle + reach)).astype(np.int64) - first + 1
    check_cells(shape.tolist(), "the box of voxels that a mount can reach")
    return first, shape


def are_spheres_free(
    voxel_states: VoxelStates, centers: ArrayLike, radii: ArrayLike, margin: float = 0.0
) -> NDArray[np.bool_]:
    """Whether all spheres of each set are free: centers (..., s, 3), radii (s,) -> (...,)."""
    inflated = np.asarray(radii, dtype=np.float64) + margin
    clear: NDArray[np.bool_] = voxel_states.sphere_states(centers, inflated) == FREE
    return np.asarray(clear.all(axis=-1))


@kernel
def copy_states(arrays: MapArrays, first: NDArray[np.int64], states: NDArray[np.uint8]) -> None:
    """Write the states of a box of voxels with the lowest index `first` (3,), maybe outside."""
    log_odds_fixed, sampled, (nx, ny, nz) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    z0 = min(max(-first[2], 0), states.shape[2])
    z1 = max(min(nz - first[2], states.shape[2]), z0)
    for i in range(states.shape[0]):
        x = first[0] + i
        for j in range(states.shape[1]):
            y = first[1] + j
            if x < 0 or x >= nx or y < 0 or y >= ny or z0 == z1:
                states[i, j] = OUTSIDE
                continue
            states[i, j, :z0] = OUTSIDE
            states[i, j, z1:] = OUTSIDE
            start = (x * ny + y) * nz + first[2]
            column = states[i, j, z0:z1]
            log_odds, known = (
                log_odds_fixed[start + z0 : start + z1],
                sampled[start + z0 : start + z1],
            )
            for k in range(z1 - z0):
                # FREE, UNKNOWN or OCCUPIED without a branch, so that the loop is vectorised
                column[k] = (1 - known[k]) + 2 * known[k] * (log_odds[k] >= FREE_LOG_ODDS_FIXED)


@kernel
def sphere_state(states: NDArray[np.uint8], x: float, y: float, z: float, radius: float) -> int:
    """The worst state that a sphere touches; all in voxels from the lower corner of the box."""
    nx, ny, nz = states.shape
    x0, x1 = int(np.floor(x - radius)), int(np.floor(x + radius))
    y0, y1 = int(np.floor(y - radius)), int(np.floor(y + radius))
    z0, z1 = int(np.floor(z - radius)), int(np.floor(z + radius))
    if x0 < 0 or y0 < 0 or z0 < 0 or x1 >= nx or y1 >= ny or z1 >= nz:
        return OUTSIDE
    worst = 0
    limit = radius * radius
    for i in range(x0, x1 + 1):
        dx = max(i - x, x - i - 1.0, 0.0)
        for j in range(y0, y1 + 1):
            dy = max(j - y, y - j - 1.0, 0.0)
            left = limit - dx * dx - dy * dy
            if left <= 0.0:
                continue
            for k in range(z0, z1 + 1):
                state = states[i, j, k]
                if state > worst:
                    dz = max(k - z, z - k - 1.0, 0.0)
                    if dz * dz < left:
                        worst = state
    return worst


@kernel
def sphere_states(
    states: NDArray[np.uint8],
    lower: NDArray[np.float64],
    resolution: float,
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
    out: NDArray[np.uint8],
) -> None:
    """Write `sphere_state` of spheres (s,) in metres."""
    for s in range(len(centers)):
        x = (centers[s, 0] - lower[0]) / resolution
        y = (centers[s, 1] - lower[1]) / resolution
        z = (centers[s, 2] - lower[2]) / resolution
        out[s] = sphere_state(states, x, y, z, radii[s] / resolution)
