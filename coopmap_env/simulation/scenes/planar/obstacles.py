"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of assorted size and orientation are strewn over the plane, without regard for
each other, until they take up the share of it that was asked for. Blocks may overlap (which
makes shapes that are not convex) and may stick out of the world. No wall surrounds it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.simulation.scenes.planar.blocks import scatter_blocks
from coopmap_env.simulation.scenes.planar.world import PlanarWorld, check_resolution, check_shape

MAX_OCCUPIED_FRACTION = 0.5
"""Above this share the free space falls apart into pockets, and a robot sees one of them."""

_MAX_EDGES = 6
_EDGE_DISTANCES = (0.7, 1.0)
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
    occupied_fraction: float = 0.12
    """Share of all cells that are occupied, met to the cell: enough to hide what lies behind,
    little enough to leave passages. The paper does not state its own."""
    side_min: float = 4.0
    """Shortest side of a block in metres: a few cells, so that its orientation shows."""
    side_max: float = 20.0
    """Longest side of a block in metres: about a depth of field, so that going around pays."""
    polygon_fraction: float = 0.4
    """Chance that a block is a convex polygon of 3 to 6 edges; otherwise it is a rectangle."""

    def __post_init__(self) -> None:
        check_shape(self.shape)
        check_resolution(self.resolution)
        if not 0.0 <= self.occupied_fraction <= MAX_OCCUPIED_FRACTION:
            raise ValueError(
                f"occupied_fraction must lie in [0, {MAX_OCCUPIED_FRACTION}], not {self.occupied_fraction!r}"
            )
        if not self.resolution <= self.side_min <= self.side_max < math.inf:
            raise ValueError(
                "sides must satisfy resolution <= side_min <= side_max, not "
                f"{self.resolution!r}, {self.side_min!r}, {self.side_max!r}"
            )
        if not 0.0 <= self.polygon_fraction <= 1.0:
            raise ValueError(f"polygon_fraction must lie in [0, 1], not {self.polygon_fraction!r}")

    @property
    def name(self) -> str:
        """What the scene is called in reports."""
        return "obstacles"

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Strew blocks until the occupied share is met.

        The last block would overshoot. It is shrunk about its centre instead, until the cells
        that it adds are just the missing ones, so the share is exact and no shape is cut.
        """
        occupied = np.zeros(self.shape, dtype=np.bool_)
        n_missing = round(self.occupied_fraction * occupied.size)
        while n_missing > 0:
            centres = rng.random((_BATCH, 2)) * self.shape
            edge_headings, distances, reaches = self._random_blocks(rng, _BATCH)
            slopes = np.stack(
                [np.cos(2 * np.pi * edge_headings), np.sin(2 * np.pi * edge_headings)], axis=-1
            )
            slopes /= distances[:, :, None]
            n_missing = scatter_blocks(occupied, n_missing, centres, reaches, slopes)
        return PlanarWorld(occupied, self.resolution, self.origin, self.name)

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
        reaches = half_sides.max(axis=1) / np.cos(widest_gap[:, 0] / 2)
        return edge_headings, distances, reaches
