"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of random size and orientation are scattered, independently of each other, until
they occupy the requested fraction of the cells. Blocks may overlap (which makes shapes that are
not convex) and may reach beyond the border of the world. No wall surrounds it.
"""

import math
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import Bounds, Settings, UnitInterval
from coopmap_env.simulation.scenes.planar._blocks import (
    BlockDraws,
    BlockLaw,
    scatter_blocks,
    write_worlds,
)
from coopmap_env.simulation.scenes.planar.world import CellSide, CellsPerSide, PlanarWorld

MAX_OCCUPIED_FRACTION = 0.5
"""Above this fraction the free space falls apart into pockets, and a robot sees one of them."""

BlockSide = Annotated[float, Bounds(above=0, largest=1e12)]

_BATCH = 128
"""Blocks drawn at once: twice what a world of the default settings takes."""


@dataclass(frozen=True)
class Obstacles(Settings):
    """Worlds of randomly placed convex blocks."""

    shape: tuple[CellsPerSide, CellsPerSide] = (200, 200)
    """Cells along x and y: large against what one view shows, as in Figure 7."""
    resolution: CellSide = 1.0
    """Side of a cell in metres: Table 1 gives its distances in cells, so they are metres here."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Lower corner of cell (0, 0) in metres."""
    occupied_fraction: Annotated[float, Bounds(at_least=0, at_most=MAX_OCCUPIED_FRACTION)] = 0.12
    """Fraction of all cells that are occupied, exact to the cell: enough to hide what lies behind,
    little enough to leave passages. The paper does not state its own."""
    side_min: BlockSide = 4.0
    """Shortest side of a block in metres: a few cells, so that its orientation shows."""
    side_max: BlockSide = 20.0
    """Longest side of a block in metres: about a depth of field, so that going around pays."""
    polygon_fraction: UnitInterval = 0.4
    """Chance that a block is a convex polygon of 3 to 6 edges; otherwise it is a rectangle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_cells(self.shape, f"Obstacles.shape {self.shape}")
        if not self.resolution <= self.side_min <= self.side_max:
            raise ValueError(
                "Obstacles needs resolution <= side_min <= side_max, got "
                f"{self.resolution!r}, {self.side_min!r}, {self.side_max!r}"
            )

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "obstacles"

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Scatter blocks until the occupied fraction is reached.

        The last block would overshoot. It is shrunk about its center until the cells that it adds
        are exactly the missing ones, so the fraction is exact and no shape is cut.
        """
        occupied = np.zeros(self.shape, dtype=np.bool_)
        draws, n_missing = BlockDraws.empty(_BATCH), self._n_occupied
        while n_missing > 0:
            draws.draw(rng)
            n_missing = scatter_blocks(occupied, n_missing, draws, self._block_law)
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

    def write_worlds(
        self, which: NDArray[np.int64], seeds: NDArray[np.uint64], occupied: NDArray[np.bool_]
    ) -> None:
        """Write the cells of many worlds, in a tenth of the time that `world` takes for each.

        Parameters
        ----------
        which : (k,) int array
            Rows to write.
        seeds : (k, 4) uint64 array
            What the seed sequence of each world's Generator generates.
        occupied : (E, nx * ny) bool array
            Row ``which[i]`` becomes the world of ``world(default_rng(sequence))``, where the
            ``sequence.generate_state(4, numpy.uint64)`` is ``seeds[i]``.
        """
        draws = BlockDraws.empty(_BATCH)
        write_worlds(which, seeds, self._n_occupied, self._block_law, draws, occupied)

    @property
    def _n_occupied(self) -> int:
        return round(self.occupied_fraction * math.prod(self.shape))

    @property
    def _block_law(self) -> BlockLaw:
        return BlockLaw(
            self.shape,
            0.5 * self.side_min / self.resolution,
            log(self.side_max / self.side_min),
            float(self.polygon_fraction),
        )
