"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of random size and orientation are scattered, independently of each other, until
they occupy the requested fraction of the cells. Blocks may overlap (which makes shapes that are
not convex) and may reach beyond the border of the world. No wall surrounds it.
"""

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import exp_array, log, sin_cos_array
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import Bounds, Positive, Settings, UnitInterval
from coopmap_env.simulation.scenes.planar._blocks import scatter_blocks
from coopmap_env.simulation.scenes.planar.world import CellSide, CellsPerSide, PlanarWorld

MAX_OCCUPIED_FRACTION = 0.5
"""Above this fraction the free space falls apart into pockets, and a robot sees one of them."""

_MAX_EDGES = 6
_EDGE_DISTANCES = (0.7, 1.0)
"""Distance of a polygon's edges from its center, as a fraction of its half side."""
_JITTER = 0.1
"""How far a polygon's edges are rotated, as a fraction of the gap between them: so little that each
gap stays well under half a turn, which keeps the block bounded and not too thin."""
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
            centers = rng.random((_BATCH, 2)) * self.shape
            edge_headings, distances, reaches = self._random_blocks(rng, _BATCH)
            angles = 2 * np.pi * edge_headings
            slopes = np.stack(sin_cos_array(angles)[::-1], axis=-1)
            slopes /= distances[:, :, None]
            n_missing = scatter_blocks(occupied, n_missing, centers, reaches, slopes)
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

    def _random_blocks(
        self, rng: np.random.Generator, n: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Draw blocks about the origin, as the edges that bound them.

        Half sides are log-uniform: many small blocks, few large ones.

        Returns
        -------
        edge_headings : (n, 6) float array
            Headings of the outward normals in full turns, ascending within one turn.
        distances : (n, 6) float array
            Distances of the edges from the origin in cells; infinite where a block has fewer.
        reaches : (n,) float array
            No point of a block lies further than this from the origin, in cells.
        """
        ratio = self.side_max / self.side_min
        ratios = exp_array(log(ratio) * rng.random((n, 2)))
        half_sides = 0.5 * self.side_min / self.resolution * ratios
        is_polygon = rng.random((n, 1)) < self.polygon_fraction
        n_edges = np.where(is_polygon, rng.integers(3, _MAX_EDGES + 1, size=(n, 1)), 4)
        jitter = np.where(is_polygon, _JITTER * rng.random((n, _MAX_EDGES)), 0.0)
        edges = np.arange(_MAX_EDGES)
        edge_headings = rng.random((n, 1)) + (edges + jitter) / n_edges
        cut = _EDGE_DISTANCES[0] + (_EDGE_DISTANCES[1] - _EDGE_DISTANCES[0]) * rng.random(
            (n, _MAX_EDGES)
        )
        rectangle = half_sides[:, edges % 2]
        polygon = half_sides.mean(axis=1, keepdims=True) * cut
        distances = np.where(is_polygon, polygon, rectangle)
        distances[edges >= n_edges] = np.inf
        # Within half a gap of an edge's normal the block ends at distance / cos(half gap).
        widest_gap = 2 * np.pi * (1 + _JITTER) / n_edges
        reaches = half_sides.max(axis=1) / sin_cos_array(widest_gap[:, 0] / 2)[1]
        return edge_headings, distances, reaches
