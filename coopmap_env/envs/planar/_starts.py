"""Start poses of a planar team: close together, in the largest free region of the world."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.robots import PoseLattice
from coopmap_env.robots.planar.reachable_regions import neighbor
from coopmap_env.simulation.scenes.planar import PlanarWorld, largest_free_region

ROUNDING = 1 + 1e-9
"""A cell counts if its center is as near as a radius, but for rounding."""


def sample_start_poses(
    world: PlanarWorld,
    lattice: PoseLattice,
    n_robots: int,
    spread: float,
    radius: float,
    rng: np.random.Generator,
) -> tuple[tuple[int, ...], NDArray[np.int64]]:
    """Sample the start poses, and the cells that are known to be free around them.

    Parameters
    ----------
    world : World
    lattice : PoseLattice
    n_robots : int
    spread : float
        Metres: teammates start no further than this from the first robot.
    radius : float
        Metres around each start within which free cells are known, if connected to it.
    rng : numpy.random.Generator

    Returns
    -------
    pose_ids : tuple of int
        Pose ids; cells are different as long as there are enough within `spread`.
    known : ndarray, shape (k,)
        Flat indices of the known cells: the truly free ones around the starts, none of them
        behind a wall.
    """
    region = largest_free_region(world.occupied)
    first = int(find_nth(region.ravel(), int(rng.integers(np.count_nonzero(region)))))
    near = _disc(region, first, spread / world.resolution)
    others = rng.permutation(near[near != first])
    starts = np.resize(np.append(first, others), n_robots).tolist()  # repeats if too few
    headings = rng.integers(lattice.n_headings, size=n_robots).tolist()
    pose_ids = tuple(
        cell * lattice.n_headings + heading for cell, heading in zip(starts, headings, strict=True)
    )
    known = [connected_cells(world.occupied, cell, radius / world.resolution) for cell in starts]
    return pose_ids, np.unique(np.concatenate(known))


@kernel
def find_nth(mask: NDArray[np.bool_], n: int) -> int:
    """Index of the n-th true entry, counted from 0; -1 if there are fewer."""
    for k in range(len(mask)):
        n -= mask[k]
        if n < 0:
            return k
    return -1


@kernel
def connected_cells(occupied: NDArray[np.bool_], start: int, radius: float) -> NDArray[np.int64]:
    """Free cells (flat) no further than `radius` cells from a start, if connected to it by faces.

    The paths between them stay within the radius too.
    """
    nx, ny = occupied.shape
    flat, limit = occupied.ravel(), (radius * ROUNDING) ** 2
    found = np.zeros(nx * ny, np.bool_)
    cells = np.empty(nx * ny, np.int64)
    cells[0], n = start, 1
    found[start] = True
    head = 0
    while head < n:
        cell = cells[head]
        head += 1
        for side in range(4):
            beside = neighbor(cell, side, (nx, ny, 1))
            if beside < 0 or found[beside] or flat[beside]:
                continue
            i, j = beside // ny - start // ny, beside % ny - start % ny
            if i * i + j * j <= limit:
                found[beside] = True
                cells[n] = beside
                n += 1
    return cells[:n].copy()


def _disc(mask: NDArray[np.bool_], cell: int, radius: float) -> NDArray[np.int64]:
    """Flat indices of the cells of `mask` no further than `radius` cells from a cell."""
    nx, ny = mask.shape
    x, y = divmod(cell, ny)
    radius *= ROUNDING
    reach = math.floor(radius)
    i = np.arange(max(x - reach, 0), min(x + reach + 1, nx))
    j = np.arange(max(y - reach, 0), min(y + reach + 1, ny))
    near = (i[:, None] - x) ** 2 + (j - y) ** 2 <= radius**2
    near &= mask[i[0] : i[-1] + 1, j[0] : j[-1] + 1]
    flat = i[:, None] * ny + j
    return flat[near]
