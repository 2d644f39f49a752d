"""Random obstacles in the open: the planar environment of the paper's Figure 7.

Convex blocks of assorted size and orientation are strewn over the plane, without regard for
each other, until they take up the share of it that was asked for. Blocks may overlap (which
makes shapes that are not convex) and may stick out of the world. No wall surrounds it.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .world import World, check_resolution, check_shape

MOST_OCCUPIED = 0.5
"""Above this share the free space falls apart into pockets, and a robot sees one of them."""

_CUT = (0.7, 1.0)
"""Distance of a polygon's edges from its centre, as a share of its half side."""


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
            missing -= self._strew_block(rng, occupied, missing)
        return World(occupied, self.resolution, self.origin, self.name)

    def _strew_block(
        self, rng: np.random.Generator, occupied: NDArray[np.bool_], at_most: int
    ) -> int:
        """Occupy the cells of one random block, `at_most` new ones; return how many were new."""
        turns, distances = self._random_block(rng)
        centre = rng.random(2) * self.shape
        # Within half a gap of an edge's normal the block ends at distance / cos(half gap).
        widest_gap = np.diff(turns, append=turns[0] + 1.0).max()
        reach = distances.max() / math.cos(math.pi * widest_gap)
        lower = np.maximum(centre - reach, 0).astype(int)
        upper = np.minimum(centre + reach + 1, self.shape).astype(int)
        patch = occupied[lower[0] : upper[0], lower[1] : upper[1]]
        x = np.arange(lower[0], upper[0]) + 0.5 - centre[0]
        y = np.arange(lower[1], upper[1]) + 0.5 - centre[1]
        # The gauge of a convex block: 0 at its centre, 1 on its edge, s on the block scaled by s.
        slope_x = np.cos(2 * np.pi * turns) / distances
        slope_y = np.sin(2 * np.pi * turns) / distances
        gauge = (slope_x[:, None, None] * x[:, None] + slope_y[:, None, None] * y).max(axis=0)
        gauge[patch] = np.inf
        new = np.flatnonzero(gauge <= 1.0)
        if len(new) > at_most:
            new = new[np.argsort(gauge.ravel()[new], kind="stable")[:at_most]]
        patch[np.unravel_index(new, patch.shape)] = True
        return len(new)

    def _random_block(
        self, rng: np.random.Generator
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw a block about the origin, as the edges that bound it.

        Half sides are log-uniform: many small blocks, few large ones.

        Returns
        -------
        turns : (k,) float array
            Headings of the outward normals in full turns, ascending within one turn.
        distances : (k,) float array
            Distances of the edges from the origin in cells.
        """
        heading, kind, *sides = rng.random(4)
        half_sides = (
            0.5 * self.side_min * (self.side_max / self.side_min) ** np.array(sides)
        ) / self.resolution
        if kind >= self.polygon_share:
            return heading + np.arange(4) / 4, np.tile(half_sides, 2)
        n_edges = int(rng.integers(3, 7))
        # The jitter keeps each gap well under half a turn: the block is bounded and no needle.
        turns = heading + (np.arange(n_edges) + 0.1 * rng.random(n_edges)) / n_edges
        cut = _CUT[0] + (_CUT[1] - _CUT[0]) * rng.random(n_edges)
        return turns, half_sides.mean() * cut
