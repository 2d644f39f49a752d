"""Convex blocks: how they are drawn, and which cells they cover.

A block is given by the slopes n_k / d_k of its edges: the outward normals over the distances from
the center. Its gauge is 0 at its center, 1 on its edge and s on the edge of the block scaled by s
about its center:

    gauge(p) = max_k p . n_k / d_k.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import exp, sin_cos
from coopmap_env.core.kernels import kernel, unchecked_division_kernel

MAX_EDGES = 6
_MIN_EDGES = 3
_EDGE_DISTANCES = (0.7, 1.0)
"""Distance of a polygon's edges from its center, as a fraction of its half side."""
_JITTER = 0.1
"""How far a polygon's edges are rotated, as a fraction of the gap between them: so little that each
gap stays well under half a turn, which keeps the block bounded and not too thin."""


class BlockDraws(NamedTuple):
    """Random numbers of n blocks; uniform in [0, 1) but for the numbers of edges."""

    centers: NDArray[np.float64]
    """Shape (n, 2)."""
    sizes: NDArray[np.float64]
    """Shape (n, 2)."""
    kinds: NDArray[np.float64]
    """Shape (n,)."""
    n_edges: NDArray[np.int64]
    """Of a polygon (n,)."""
    jitters: NDArray[np.float64]
    """Shape (n, MAX_EDGES)."""
    headings: NDArray[np.float64]
    """Shape (n,)."""
    cuts: NDArray[np.float64]
    """Shape (n, MAX_EDGES)."""

    @classmethod
    def draw(cls, rng: np.random.Generator, n: int) -> BlockDraws:
        """Draw those of n blocks."""
        places, n_edges = rng.random(5 * n), rng.integers(_MIN_EDGES, MAX_EDGES + 1, size=n)
        edges = rng.random((2 * MAX_EDGES + 1) * n)
        after_jitters = MAX_EDGES * n
        return cls(
            places[: 2 * n].reshape(n, 2),
            places[2 * n : 4 * n].reshape(n, 2),
            places[4 * n :],
            n_edges,
            edges[:after_jitters].reshape(n, MAX_EDGES),
            edges[after_jitters : after_jitters + n],
            edges[after_jitters + n :].reshape(n, MAX_EDGES),
        )


class BlockLaw(NamedTuple):
    """How blocks are distributed."""

    shortest_half_side: float
    """Cells."""
    log_ratio: float
    """Logarithm of the longest side over the shortest. Half sides are log-uniform: many small
    blocks, few large ones."""
    polygon_fraction: float
    """Chance of a polygon; other blocks are rectangles."""


@kernel
def shape_blocks(
    draws: BlockDraws, law: BlockLaw, slopes: NDArray[np.float64], reaches: NDArray[np.float64]
) -> None:
    """Write the slopes (n, MAX_EDGES, 2) of the edges of blocks, and how far they reach (n,).

    Slopes of zero stand for no edge. Reaches are in cells.
    """
    nearest, furthest = _EDGE_DISTANCES
    for block in range(len(reaches)):
        half_0 = law.shortest_half_side * exp(law.log_ratio * draws.sizes[block, 0])
        half_1 = law.shortest_half_side * exp(law.log_ratio * draws.sizes[block, 1])
        is_polygon = draws.kinds[block] < law.polygon_fraction
        n_edges = draws.n_edges[block] if is_polygon else 4
        slopes[block] = 0.0
        for edge in range(n_edges):
            jitter, distance = 0.0, half_1 if edge % 2 else half_0
            if is_polygon:
                jitter = _JITTER * draws.jitters[block, edge]
                cut = nearest + (furthest - nearest) * draws.cuts[block, edge]
                distance = (half_0 + half_1) / 2.0 * cut
            turns = draws.headings[block] + (edge + jitter) / n_edges
            sine, cosine = sin_cos(2.0 * math.pi * turns)
            slopes[block, edge, 0] = cosine / distance
            slopes[block, edge, 1] = sine / distance
        # Within half a gap of an edge's normal the block ends at distance / cos(half gap).
        widest_gap = 2.0 * math.pi * (1.0 + _JITTER) / n_edges
        reaches[block] = max(half_0, half_1) / sin_cos(widest_gap / 2.0)[1]


@unchecked_division_kernel
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
    cells = np.empty(nx * ny, np.int32)
    for block in range(len(centers)):
        if n_missing == 0:
            break
        cx, cy, reach = centers[block, 0], centers[block, 1], reaches[block]
        n = 0
        for x in range(max(int(cx - reach), 0), min(int(cx + reach) + 1, nx)):
            low, high = chord(slopes[block], x + 0.5 - cx, reach)
            first, last = math.ceil(cy + low - 0.5), math.floor(cy + high - 0.5)
            for y in range(np.uint64(max(first, 0)), np.uint64(max(min(last + 1, ny), 0))):
                cell = np.uint64(x * ny) + y
                cells[np.uint64(n)] = cell
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


@unchecked_division_kernel
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
