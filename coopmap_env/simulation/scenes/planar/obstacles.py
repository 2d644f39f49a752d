"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of random size and orientation are scattered, independently of each other, until
they occupy the requested fraction of the cells. Blocks may overlap (which makes shapes that are
not convex) and may reach beyond the border of the world. No wall surrounds it.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import Bounds, Positive, Settings, UnitInterval
from coopmap_env.simulation.scenes.planar._blocks import (
    MAX_EDGES,
    BlockDraws,
    BlockLaw,
    scatter_blocks,
    shape_blocks,
)
from coopmap_env.simulation.scenes.planar.world import CellSide, CellsPerSide, PlanarWorld

MAX_OCCUPIED_FRACTION = 0.5
"""Above this fraction the free space falls apart into pockets, and a robot sees one of them."""

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
    side_min: Positive = 4.0
    """Shortest side of a block in metres: a few cells, so that its orientation shows."""
    side_max: Positive = 20.0
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
        n_missing = round(self.occupied_fraction * occupied.size)
        while n_missing > 0:
            n_missing = scatter_blocks(occupied, n_missing, *self._random_blocks(rng, _BATCH))
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

    def _random_blocks(
        self, rng: np.random.Generator, n: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Draw what `scatter_blocks` needs of n blocks."""
        draws = BlockDraws.draw(rng, n)
        law = BlockLaw(
            0.5 * self.side_min / self.resolution,
            log(self.side_max / self.side_min),
            float(self.polygon_fraction),
        )
        slopes, reaches = np.empty((n, MAX_EDGES, 2)), np.empty(n)
        shape_blocks(draws, law, slopes, reaches)
        return draws.centers * self.shape, reaches, slopes
