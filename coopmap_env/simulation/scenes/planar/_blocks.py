"""Convex blocks, drawn row by row.

A block is given by the slopes n_k / d_k of its edges: the outward normals over the distances from
the center. Its gauge is 0 at its center, 1 on its edge and s on the edge of the block scaled by s
about its center:

    gauge(p) = max_k p . n_k / d_k.
"""

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel


@kernel
def scatter_blocks(
    occupied: NDArray[np.bool_],
    n_missing: int,
    centers: NDArray[np.float64],
    reaches: NDArray[np.float64],
    slopes: NDArray[np.float64],
) -> int:
    """Occupy the cells of one block after the other until `n_missing` more cells are occupied.

    The block that would overshoot is shrunk about its center until it adds just the cells that
    are missing; of cells on the same edge the first in C order are taken.

    Parameters
    ----------
    occupied : (nx, ny) bool array
        Changed in place.
    n_missing : int
        Number of cells to occupy.
    centers : (n, 2) float array
        In cells from the lower corner of the world.
    reaches : (n,) float array
        No cell of a block lies further than this from its center along x or y.
    slopes : (n, k, 2) float array
        n_k / d_k of the edges; zeros stand for no edge.

    Returns
    -------
    int
        Number of cells that are still missing: above 0 if the blocks were too few.
    """
    nx, ny = occupied.shape
    flat = occupied.ravel()
    cells = np.empty(nx * ny, np.int64)
    for block in range(len(centers)):
        if n_missing == 0:
            break
        cx, cy, reach = centers[block, 0], centers[block, 1], reaches[block]
        n = 0
        for x in range(max(int(cx - reach), 0), min(int(cx + reach) + 1, nx)):
            low, high = chord(slopes[block], x + 0.5 - cx, reach)
            first, last = math.ceil(cy + low - 0.5), math.floor(cy + high - 0.5)
            for cell in range(x * ny + max(first, 0), x * ny + min(last + 1, ny)):
                cells[n] = cell
                n += not flat[cell]
        new = cells[:n]
        if n > n_missing:
            gauges = np.empty(n)
            for k in range(n):
                x, y = divmod(new[k], ny)
                gauges[k] = gauge(slopes[block], x + 0.5 - cx, y + 0.5 - cy)
            new = new[np.argsort(gauges, kind="mergesort")[:n_missing]]
        for cell in new:
            flat[cell] = True
        n_missing -= len(new)
    return n_missing


@kernel
def chord(slopes: NDArray[np.float64], x: float, reach: float) -> tuple[float, float]:
    """Lowest and highest y of the block at x cells from its center; empty if lowest > highest."""
    low, high = -reach, reach
    for edge in range(len(slopes)):
        rest, slope = 1.0 - slopes[edge, 0] * x, slopes[edge, 1]
        if slope > 0.0:
            high = min(high, rest / slope)
        elif slope < 0.0:
            low = max(low, rest / slope)
        elif rest < 0.0:
            low = math.inf
    return (low, high) if low <= high else (1.0, -1.0)


@kernel
def gauge(slopes: NDArray[np.float64], x: float, y: float) -> float:
    """Gauge at (x, y) cells from the center of the block whose edges have these slopes (k, 2)."""
    largest = 0.0
    for edge in range(len(slopes)):
        largest = max(largest, slopes[edge, 0] * x + slopes[edge, 1] * y)
    return largest
