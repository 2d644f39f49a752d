"""Piling: blocks come down one after the other and rest on what lies there.

The pile is known by its height over a fine raster of columns. A block keeps its orientation and
sinks until one column stops it; a pile that has settled by its own weight would lie a little
flatter, and the blocks are pushed into each other by `SUNK` to look so.
"""

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

COLUMN = 0.08
"""Side of a column in metres: less than half of the smallest block."""
SUNK = 0.04
"""Metres by which a block sinks into what it rests on."""


@dataclass(frozen=True, eq=False)
class Rest:
    """Where a block comes to rest."""

    centre: NDArray[np.float64]
    top: float
    """z of its highest point."""
    below: int
    """Number of the block that stops it, -1 for the ground."""
    columns: tuple[slice, ...]
    """Columns around it."""
    tops: NDArray[np.float64]
    """Its highest z over these columns, -inf where it is not."""


class Pile:
    """Heights of what lies within `reach` metres of the origin, along x and y."""

    def __init__(self, reach: float) -> None:
        n = 2 * math.ceil(reach / COLUMN)
        self._middles = (np.arange(n) + 0.5 - n / 2) * COLUMN
        self.heights = np.zeros((n, n))
        self.owners = np.full((n, n), -1)
        """Number of the block on top of each column, -1 for the ground."""

    def rest(
        self, size: NDArray[np.float64], middle: NDArray[np.float64], rotation: NDArray[np.float64]
    ) -> "Rest":
        """Find where a block of sides `size` (3,) comes to rest.

        Its centre comes down at `middle` (2,); `rotation` (3, 3) is R_world_block.
        """
        reach = np.abs(rotation) @ size / 2
        columns = tuple(
            slice(*np.searchsorted(self._middles, (at - by, at + by)))
            for at, by in zip(middle, reach[:2], strict=True)
        )
        x, y = (self._middles[span] - at for span, at in zip(columns, middle, strict=True))
        lows, tops = chords(size, rotation, x, y)
        gaps = self.heights[columns] - lows
        height, below = reach[2] - SUNK, -1  # on the ground
        if gaps.size and gaps.max() > reach[2]:
            at = np.unravel_index(int(gaps.argmax()), gaps.shape)
            height, below = gaps[at] - SUNK, int(self.owners[columns][at])
        centre = np.array([*middle, height])
        return Rest(centre, float(height + reach[2]), below, columns, tops + height)

    def put(self, number: int, rest: "Rest") -> None:
        """Let a block lie where `rest` found it."""
        heights, owners = self.heights[rest.columns], self.owners[rest.columns]
        higher = rest.tops > heights
        heights[higher] = rest.tops[higher]
        owners[higher] = number


@njit(cache=True, nogil=True)
def chords(size, rotation, x, y):
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
