"""Piling: blocks are dropped one after the other and rest on what lies there.

The pile is described by its height over a fine raster of columns. A block keeps its orientation
and sinks until one column stops it. A pile that settles by its own weight is a little flatter; to
resemble one, the blocks sink into each other by `SINK_DEPTH`.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.core.linear_algebra import product

COLUMN_SIZE = 0.08
"""Side of a column in metres: less than half of the smallest block."""
SINK_DEPTH = 0.04
"""Metres by which a block sinks into what it rests on."""


@dataclass(frozen=True, eq=False)
class RestingBlock:
    """Where a block comes to rest."""

    center: NDArray[np.float64]
    top: float
    """z of its highest point."""
    support: int
    """Number of the block that stops it, -1 for the ground."""
    columns: tuple[slice, ...]
    """Columns around it."""
    tops: NDArray[np.float64]
    """Its highest z over these columns, -inf where a column misses it."""


class Pile:
    """Heights of what lies within `reach` metres of the origin, along x and y."""

    def __init__(self, reach: float) -> None:
        n = 2 * math.ceil(reach / COLUMN_SIZE)
        self._middles = (np.arange(n) + 0.5 - n / 2) * COLUMN_SIZE
        self.heights = np.zeros((n, n))
        self.top_blocks = np.full((n, n), -1)
        """Number of the block on top of each column, -1 for the ground."""

    def find_rest(
        self, size: NDArray[np.float64], middle: NDArray[np.float64], rotation: NDArray[np.float64]
    ) -> "RestingBlock":
        """Find where a block of sides `size` (3,) comes to rest.

        Its center is dropped at `middle` (2,); `rotation` (3, 3) is R_world_block.
        """
        reach = product(np.abs(rotation), size) / 2
        columns = tuple(
            slice(*np.searchsorted(self._middles, (at - by, at + by)))
            for at, by in zip(middle, reach[:2], strict=True)
        )
        x, y = (self._middles[span] - at for span, at in zip(columns, middle, strict=True))
        lows, tops = vertical_extents(size, rotation, x, y)
        gaps = self.heights[columns] - lows
        height, support = reach[2] - SINK_DEPTH, -1  # on the ground
        if gaps.size and gaps.max() > reach[2]:
            at = np.unravel_index(int(gaps.argmax()), gaps.shape)
            height, support = gaps[at] - SINK_DEPTH, int(self.top_blocks[columns][at])
        center = np.array([*middle, height])
        return RestingBlock(center, float(height + reach[2]), support, columns, tops + height)

    def add(self, number: int, rest: "RestingBlock") -> None:
        """Place a block where `find_rest` found that it comes to rest."""
        heights, top_blocks = self.heights[rest.columns], self.top_blocks[rest.columns]
        higher = rest.tops > heights
        heights[higher] = rest.tops[higher]
        top_blocks[higher] = number


@kernel
def vertical_extents(
    size: NDArray[np.float64],
    rotation: NDArray[np.float64],
    x: NDArray[np.float64],
    y: NDArray[np.float64],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Lowest and highest z (nx, ny) of a block about the origin over x (nx,) and y (ny,).

    Where a column misses the block: inf and -inf.
    """
    lows, highs = np.full((len(x), len(y)), np.inf), np.full((len(x), len(y)), -np.inf)
    for i in range(len(x)):
        for j in range(len(y)):
            low, high = -np.inf, np.inf
            for k in range(3):
                level = -(rotation[0, k] * x[i] + rotation[1, k] * y[j])
                slope, half = rotation[2, k], 0.5 * size[k]
                if abs(slope) > 1e-9:
                    one, two = (level - half) / slope, (level + half) / slope
                    low, high = max(low, min(one, two)), min(high, max(one, two))
                elif abs(level) > half:
                    high = -np.inf
            if low <= high:
                lows[i, j], highs[i, j] = low, high
    return lows, highs
