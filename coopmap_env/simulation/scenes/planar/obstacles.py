"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of assorted size and orientation are strewn over the plane, without regard for
each other, until they take up the share of it that was asked for. Blocks may overlap (which
makes shapes that are not convex) and may stick out of the world. No wall surrounds it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.scenes.planar.blocks import strew_blocks
from coopmap_env.simulation.scenes.planar.world import World, check_resolution, check_shape

MOST_OCCUPIED = 0.5
"""Above this share the free space falls apart into pockets, and a robot sees one of them."""

_MOST_EDGES = 6
_CUT = (0.7, 1.0)
"""Distance of a polygon's edges from its centre, as a share of its half side."""
_JITTER = 0.1
"""How far a polygon's edges are turned, as a share of the gap between them: so little that each
gap stays well under half a turn, which keeps the block bounded and no needle."""
_BATCH = 128
"""Blocks drawn at once: twice what a world of the default settings takes."""


@dataclass(frozen=True)
class Obstacles:
    """Worlds of randomly placed convex blocks."""

    shape: tuple[int, int] = (200, 200)
    """Cells along x and y: large against what one view shows, as in Figure 7."""
    resolution: float = 1.0
    """Side of a cell in metres: Table 1 gives its distances in cells, so they are metres here."""
    origin: tuple[float, float] = (0.0, 0.0)
    """Lower corner of cell (0, 0) in metres."""
    occupied_share: float = 0.12
    """Share of all cells that are occupied, met to the cell: enough to hide what lies behind,
    little enough to leave passages. The paper does not state its own."""
    side_min: float = 4.0
    """Shortest side of a block in metres: a few cells, so that its orientation shows."""
    side_max: float = 20.0
    """Longest side of a block in metres: about a depth of field, so that going around pays."""
    polygon_share: float = 0.4
    """Chance that a block is a convex polygon of 3 to 6 edges; otherwise it is a rectangle."""

    def __post_init__(self) -> None:
        check_shape(self.shape)
        check_resolution(self.resolution)
        if not 0.0 <= self.occupied_share <= MOST_OCCUPIED:
            raise ValueError(
                f"occupied_share must lie in [0, {MOST_OCCUPIED}], not {self.occupied_share!r}"
            )
        if not self.resolution <= self.side_min <= self.side_max < math.inf:
            raise ValueError(
                "sides must satisfy resolution <= side_min <= side_max, not "
                f"{self.resolution!r}, {self.side_min!r}, {self.side_max!r}"
            )
        if not 0.0 <= self.polygon_share <= 1.0:
            raise ValueError(f"polygon_share must lie in [0, 1], not {self.polygon_share!r}")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "obstacles"

    def world(self, rng: np.random.Generator) -> World:
        """Strew blocks until the occupied share is met.

        The last block would overshoot. It is shrunk about its centre instead, until the cells
        that it adds are just the missing ones, so the share is exact and no shape is cut.
        """
        occupied = np.zeros(self.shape, dtype=np.bool_)
        missing = round(self.occupied_share * occupied.size)
        while missing > 0:
            centres = rng.random((_BATCH, 2)) * self.shape
            turns, distances, reaches = self._random_blocks(rng, _BATCH)
            slopes = np.stack([np.cos(2 * np.pi * turns), np.sin(2 * np.pi * turns)], axis=-1)
            slopes /= distances[:, :, None]
            missing = strew_blocks(occupied, missing, centres, reaches, slopes)
        return World(occupied, self.resolution, self.origin, self.name)

    def _random_blocks(
        self, rng: np.random.Generator, n: int
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Draw blocks about the origin, as the edges that bound them.

        Half sides are log-uniform: many small blocks, few large ones.

        Returns
        -------
        turns : (n, 6) float array
            Headings of the outward normals in full turns, ascending within one turn.
        distances : (n, 6) float array
            Distances of the edges from the origin in cells; infinite where a block has fewer.
        reaches : (n,) float array
            No point of a block lies further than this from the origin, in cells.
        """
        ratio = self.side_max / self.side_min
        half_sides = 0.5 * self.side_min / self.resolution * ratio ** rng.random((n, 2))
        is_polygon = rng.random((n, 1)) < self.polygon_share
        n_edges = np.where(is_polygon, rng.integers(3, _MOST_EDGES + 1, size=(n, 1)), 4)
        jitter = np.where(is_polygon, _JITTER * rng.random((n, _MOST_EDGES)), 0.0)
        edges = np.arange(_MOST_EDGES)
        turns = rng.random((n, 1)) + (edges + jitter) / n_edges
        cut = _CUT[0] + (_CUT[1] - _CUT[0]) * rng.random((n, _MOST_EDGES))
        rectangle = half_sides[:, edges % 2]
        polygon = half_sides.mean(axis=1, keepdims=True) * cut
        distances = np.where(is_polygon, polygon, rectangle)
        distances[edges >= n_edges] = np.inf
        # Within half a gap of an edge's normal the block ends at distance / cos(half gap).
        widest_gap = 2 * np.pi * (1 + _JITTER) / n_edges
        reaches = half_sides.max(axis=1) / np.cos(widest_gap[:, 0] / 2)
        return turns, distances, reaches
