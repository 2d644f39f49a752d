"""Digging corridors and chambers: the convex blocks that they are made of, and their cells.

A block is given by its center, how far it reaches and the slopes of its edges; see `_blocks`.
Lengths are in cells.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.simulation.scenes.planar._blocks import allocate_rows, occupy_block

_N_EDGES = 8
_SIDES_AND_CORNERS = np.array(
    [[1, 0], [-1, 0], [0, 1], [0, -1], [1, 1], [1, -1], [-1, 1], [-1, -1]], dtype=np.float64
)
"""Outward directions of the four sides of a box and of the edges that cut its corners."""


class Blocks(NamedTuple):
    """n convex blocks."""

    centers: NDArray[np.float64]
    """Shape (n, 2)."""
    reaches: NDArray[np.float64]
    """No point of a block lies further than this from its center (n,)."""
    slopes: NDArray[np.float64]
    """Of the edges (n, 8, 2); zeros stand for no edge."""


def boxes(
    centers: NDArray[np.float64], half_sides: NDArray[np.float64], corner_gauge: float
) -> Blocks:
    """Boxes along the axes with cut corners.

    Parameters
    ----------
    centers, half_sides : (n, 2) float arrays
    corner_gauge : float
        Where the corners are cut: at 1 nothing but a diamond is left, at 2 nothing is cut; at 1.4
        a square becomes a nearly regular octagon.
    """
    slopes = _SIDES_AND_CORNERS / half_sides[:, None]
    slopes[:, 4:] /= corner_gauge
    return Blocks(centers, half_sides[:, 0] + half_sides[:, 1], slopes)


def strips(
    starts: NDArray[np.float64], ends: NDArray[np.float64], half_widths: NDArray[np.float64]
) -> Blocks:
    """Rectangles along the lines from points (n, 2) to other ones, as wide as given (n,)."""
    along = ends - starts
    half_lengths = np.sqrt(along[:, 0] * along[:, 0] + along[:, 1] * along[:, 1]) / 2
    forward = along / (2 * half_lengths[:, None])
    left = np.stack([-forward[:, 1], forward[:, 0]], axis=-1)
    slopes = np.zeros((len(along), _N_EDGES, 2))
    slopes[:, 0] = forward / half_lengths[:, None]
    slopes[:, 1] = -slopes[:, 0]
    slopes[:, 2] = left / half_widths[:, None]
    slopes[:, 3] = -slopes[:, 2]
    return Blocks((starts + ends) / 2, half_lengths + half_widths, slopes)


def dig(shape: tuple[int, int], blocks: list[Blocks]) -> NDArray[np.bool_]:
    """Cells of a world whose middles lie in a block, boundary included: shape (nx, ny)."""
    dug = np.zeros(shape, dtype=np.bool_)
    mark_blocks(dug, *map(np.concatenate, zip(*blocks, strict=True)))
    return dug


@kernel
def mark_blocks(
    marked: NDArray[np.bool_],
    centers: NDArray[np.float64],
    reaches: NDArray[np.float64],
    slopes: NDArray[np.float64],
) -> None:
    """Set the cells (nx, ny) of all blocks to true."""
    rows = allocate_rows(len(marked))
    for k in range(len(centers)):
        center = centers[k, 0], centers[k, 1]
        occupy_block(marked, marked.size, center, reaches[k], slopes[k], rows)
