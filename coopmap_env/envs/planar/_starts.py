"""Start poses of a planar team: close together, in the largest free region of the world."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.robots import PoseLattice
from coopmap_env.simulation.scenes.planar import PlanarWorld, largest_free_region


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
    cells = np.flatnonzero(region)
    first = int(cells[rng.integers(len(cells))])
    near = _disc(region, first, spread / world.resolution)
    others = rng.permutation(near[near != first])
    starts = np.resize(np.append(first, others), n_robots).tolist()  # repeats if too few
    headings = rng.integers(lattice.n_headings, size=n_robots).tolist()
    pose_ids = tuple(
        cell * lattice.n_headings + heading for cell, heading in zip(starts, headings, strict=True)
    )
    free = ~world.occupied
    known = [
        _connected_cells(_disc(free, cell, radius / world.resolution), cell, world)
        for cell in starts
    ]
    return pose_ids, np.unique(np.concatenate(known))


def _connected_cells(cells: NDArray[np.int64], start: int, world: PlanarWorld) -> NDArray[np.int64]:
    """The cells that are connected with the start by faces."""
    ny = world.shape[1]
    left, found = set(cells.tolist()) - {start}, [start]
    for cell in found:
        sides = (
            cell - ny,
            cell + ny,
            cell - 1 if cell % ny else -1,
            (cell + 1) if (cell + 1) % ny else -1,
        )
        for side in left.intersection(sides):
            left.remove(side)
            found.append(side)
    return np.array(found)


def _disc(mask: NDArray[np.bool_], cell: int, radius: float) -> NDArray[np.int64]:
    """Flat indices of the cells of `mask` no further than `radius` cells from a cell."""
    nx, ny = mask.shape
    x, y = divmod(cell, ny)
    radius *= 1 + 1e-9  # a cell counts if its center is that near, but for rounding
    reach = math.floor(radius)
    i = np.arange(max(x - reach, 0), min(x + reach + 1, nx))
    j = np.arange(max(y - reach, 0), min(y + reach + 1, ny))
    near = (i[:, None] - x) ** 2 + (j - y) ** 2 <= radius**2
    near &= mask[i[0] : i[-1] + 1, j[0] : j[-1] + 1]
    flat = i[:, None] * ny + j
    return flat[near]
