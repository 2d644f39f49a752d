"""A scene that always makes the same world: a recorded map."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import PositiveInt, checked_value
from coopmap_env.simulation.scenes.planar.world import PlanarWorld


@dataclass(frozen=True, eq=False)
class RecordedMap:
    """The scene of one recorded world.

    Read one with `read_map_server` or `load_house`.

    Attributes
    ----------
    truth : PlanarWorld
        The world that this scene makes; the same object every time.
    """

    truth: PlanarWorld

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return self.truth.name

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        return self.truth.shape

    @property
    def resolution(self) -> float:
        """Side of a cell in metres."""
        return self.truth.resolution

    @property
    def origin(self) -> tuple[float, float]:
        """Position in metres of the lower corner of cell (0, 0)."""
        return self.truth.origin

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Return the recorded world; `rng` is left as it is."""
        return self.truth


def max_pool(occupied: NDArray[np.bool_], factor: int) -> NDArray[np.bool_]:
    """Join blocks of cells into one: occupied if any of them is, so no wall gets a hole.

    Blocks start at cell (0, 0). Those cut by the upper borders count by the cells that they have.

    Parameters
    ----------
    occupied : (nx, ny) bool array
        True where something stands.
    factor : int
        Cells per side of a block, 1 or more.

    Returns
    -------
    (ceil(nx / factor), ceil(ny / factor)) bool array
        The coarser grid.

    Raises
    ------
    ValueError
        If the factor is no integer of at least 1.
    """
    factor = checked_value("pool", factor, PositiveInt)
    for axis, side in enumerate(occupied.shape):
        starts = np.arange(0, side, min(factor, side))
        occupied = np.logical_or.reduceat(occupied, starts, axis=axis)
    return occupied
