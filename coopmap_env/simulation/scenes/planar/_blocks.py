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
from coopmap_env.core.kernels import borrowing_kernel, kernel, unchecked_division_kernel
from coopmap_env.core.pcg64 import fill_quarters, fill_uniform, seed_generator

MAX_EDGES = 6
_MIN_EDGES = 3
_EDGE_DISTANCES = (0.7, 1.0)
"""Distance of a polygon's edges from its center, as a fraction of its half side."""
_JITTER = 0.1
"""How far a polygon's edges are rotated, as a fraction of the gap between them: so little that each
gap stays well under half a turn, which keeps the block bounded and not too thin."""


class BlockDraws(NamedTuple):
    """Random numbers of n blocks; uniform in [0, 1) but for the numbers of edges.

    They are drawn in this order, those of all blocks at once.
    """

    centers: NDArray[np.float64]
    """Shape (n, 2), as fractions of the world's sides."""
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
    def empty(cls, n: int) -> BlockDraws:
        """Room for those of n blocks, an even number."""
        if n % 2:
            raise ValueError(f"blocks are drawn in even numbers, not {n}")
        return cls(
            np.empty((n, 2)),
            np.empty((n, 2)),
            np.empty(n),
            np.empty(n, dtype=np.int64),
            np.empty((n, MAX_EDGES)),
            np.empty(n),
            np.empty((n, MAX_EDGES)),
        )

    def draw(self, rng: np.random.Generator) -> None:
        """Draw new numbers for all blocks."""
        rng.random(out=self.centers)
        rng.random(out=self.sizes)
        rng.random(out=self.kinds)
        self.n_edges[:] = rng.integers(_MIN_EDGES, MAX_EDGES + 1, size=len(self.n_edges))
        rng.random(out=self.jitters)
        rng.random(out=self.headings)
        rng.random(out=self.cuts)


class BlockLaw(NamedTuple):
    """How blocks are distributed."""

    shape: tuple[int, int]
    """Cells of the world along x and y; centers are uniform in it."""
    shortest_half_side: float
    """Cells."""
    log_ratio: float
    """Logarithm of the longest side over the shortest. Half sides are log-uniform: many small
    blocks, few large ones."""
    polygon_fraction: float
    """Chance of a polygon; other blocks are rectangles."""


@borrowing_kernel
def _draw_blocks(state: NDArray[np.uint64], draws: BlockDraws) -> None:
    """`BlockDraws.draw` from the state of a generator."""
    fill_uniform(state, draws.centers.reshape(-1))
    fill_uniform(state, draws.sizes.reshape(-1))
    fill_uniform(state, draws.kinds)
    fill_quarters(state, draws.n_edges)
    for block in range(len(draws.n_edges)):
        draws.n_edges[block] += _MIN_EDGES
    fill_uniform(state, draws.jitters.reshape(-1))
    fill_uniform(state, draws.headings)
    fill_uniform(state, draws.cuts.reshape(-1))


@kernel
def write_worlds(
    which: NDArray[np.int64],
    seeds: NDArray[np.uint64],
    n_occupied: int,
    law: BlockLaw,
    draws: BlockDraws,
    occupied: NDArray[np.bool_],
) -> None:
    """Write some of the worlds (E, nx * ny), each from the seed words (4,) of a generator.

    They are those that a numpy Generator of these seeds gives by `BlockDraws.draw` and
    `scatter_blocks`, from an empty world on until `n_occupied` cells are occupied. `draws` is
    scratch.
    """
    nx, ny = law.shape
    state = np.empty(4, dtype=np.uint64)
    for row in range(len(which)):
        world = occupied[which[row]].reshape(nx, ny)
        world[:] = False
        seed_generator(seeds[row], state)
        n_missing = n_occupied
        while n_missing > 0:
            _draw_blocks(state, draws)
            n_missing = scatter_blocks(world, n_missing, draws, law)


@kernel
def scatter_blocks(
    occupied: NDArray[np.bool_], n_missing: int, draws: BlockDraws, law: BlockLaw
) -> int:
    """Occupy the cells of blocks until `n_missing` more are; return how many are still missing.

    What is missing is above 0 if the blocks were too few.
    """
    nx, ny = law.shape
    slopes = np.empty((MAX_EDGES, 2))
    buffers = allocate_rows(nx)
    for block in range(len(draws.kinds)):
        if n_missing == 0:
            break
        reach = shape_block(block, draws, law, slopes)
        center = draws.centers[block, 0] * nx, draws.centers[block, 1] * ny
        n_missing -= occupy_block(occupied, n_missing, center, reach, slopes, buffers)
    return n_missing


@borrowing_kernel
def shape_block(block: int, draws: BlockDraws, law: BlockLaw, slopes: NDArray[np.float64]) -> float:
    """Write the slopes (MAX_EDGES, 2) of a block's edges; return how far it reaches, in cells.

    Slopes of zero stand for no edge.
    """
    nearest, furthest = _EDGE_DISTANCES
    half_0 = law.shortest_half_side * exp(law.log_ratio * draws.sizes[block, 0])
    half_1 = law.shortest_half_side * exp(law.log_ratio * draws.sizes[block, 1])
    is_polygon = draws.kinds[block] < law.polygon_fraction
    n_edges = draws.n_edges[block] if is_polygon else 4
    slopes[:] = 0.0
    for edge in range(n_edges):
        jitter, distance = 0.0, half_1 if edge % 2 else half_0
        if is_polygon:
            jitter = _JITTER * draws.jitters[block, edge]
            cut = nearest + (furthest - nearest) * draws.cuts[block, edge]
            distance = (half_0 + half_1) / 2.0 * cut
        turns = draws.headings[block] + (edge + jitter) / n_edges
        sine, cosine = sin_cos(2.0 * math.pi * turns)
        slopes[edge, 0] = cosine / distance
        slopes[edge, 1] = sine / distance
    # Within half a gap of an edge's normal the block ends at distance / cos(half gap).
    widest_gap = 2.0 * math.pi * (1.0 + _JITTER) / n_edges
    return max(half_0, half_1) / sin_cos(widest_gap / 2.0)[1]


class BlockRows(NamedTuple):
    """Scratch: where a block's cells lie in each row of a world of nx rows."""

    low: NDArray[np.float64]
    """Lowest y that the block holds, from its center (nx,)."""
    high: NDArray[np.float64]
    """Highest y (nx,)."""
    starts: NDArray[np.int64]
    """First cell along y (nx,)."""
    stops: NDArray[np.int64]
    """Cell after the last one (nx,)."""


@kernel
def allocate_rows(nx: int) -> BlockRows:
    """Scratch of `occupy_block`."""
    cells = np.empty((2, nx), dtype=np.int64)
    return BlockRows(np.empty(nx), np.empty(nx), cells[0], cells[1])


@kernel
def occupy_block(
    occupied: NDArray[np.bool_],
    n_missing: int,
    center: tuple[float, float],
    reach: float,
    slopes: NDArray[np.float64],
    rows: BlockRows,
) -> int:
    """Occupy the cells of a block, `n_missing` at most; return how many were not yet.

    A block with more is shrunk about its center until it adds just the cells that are missing; of
    cells on the same edge the first in C order are taken.

    Parameters
    ----------
    occupied : (nx, ny) bool array
        Changed in place.
    n_missing : int
        Number of cells to occupy.
    center : (float, float)
        In cells from the lower corner of the world.
    reach : float
        No cell of the block lies further than this from its center along x or y.
    slopes : (k, 2) float array
        n_k / d_k of the edges; zeros stand for no edge.
    rows : BlockRows
        Scratch.

    Returns
    -------
    int
        Number of cells that are occupied now and were not.
    """
    n_free = _occupy_whole(occupied, n_missing, center, reach, slopes, rows)
    if n_free > n_missing:
        _shrink_block(occupied, n_missing, center, reach, slopes, rows, n_free)
    return min(n_free, n_missing)


@borrowing_kernel
def _rows_in_reach(occupied: NDArray[np.bool_], cx: float, reach: float) -> tuple[int, int]:
    """First and last row that a block may reach."""
    return max(int(cx - reach), 0), min(int(cx + reach), len(occupied) - 1)


@borrowing_kernel
def _occupy_whole(
    occupied: NDArray[np.bool_],
    n_missing: int,
    center: tuple[float, float],
    reach: float,
    slopes: NDArray[np.float64],
    rows: BlockRows,
) -> int:
    """`occupy_block` where `n_missing` allow for it; else nothing is changed but the rows.

    Returns how many of the block's cells were not occupied.
    """
    ny, (cx, cy) = occupied.shape[1], center
    first, last = _rows_in_reach(occupied, cx, reach)
    write_chords(slopes, first, last, cx, reach, rows)
    n_cells = 0
    for x in range(first, last + 1):
        start = max(math.ceil(cy + rows.low[x] - 0.5), 0)
        stop = max(min(math.floor(cy + rows.high[x] - 0.5) + 1, ny), start)
        rows.starts[x], rows.stops[x] = start, stop
        n_cells += stop - start
    if n_cells > n_missing:
        n_free = 0
        for x in range(first, last + 1):
            for y in range(rows.starts[x], rows.stops[x]):
                n_free += not occupied[x, y]
        if n_free > n_missing:
            return n_free
    n_free, flat = 0, occupied.reshape(-1)
    for x in range(first, last + 1):
        for cell in range(np.uint64(x * ny + rows.starts[x]), np.uint64(x * ny + rows.stops[x])):
            n_free += not flat[cell]
            flat[cell] = True
    return n_free


@kernel
def _shrink_block(
    occupied: NDArray[np.bool_],
    n_missing: int,
    center: tuple[float, float],
    reach: float,
    slopes: NDArray[np.float64],
    rows: BlockRows,
    n_free: int,
) -> None:
    """Occupy those `n_missing` of the block's free cells that have the lowest gauges."""
    cx, cy = center
    first, last = _rows_in_reach(occupied, cx, reach)
    cells, gauges = np.empty((n_free, 2), dtype=np.int64), np.empty(n_free)
    k = 0
    for x in range(first, last + 1):
        for y in range(rows.starts[x], rows.stops[x]):
            if not occupied[x, y]:
                cells[k, 0], cells[k, 1] = x, y
                gauges[k] = gauge(slopes, x + 0.5 - cx, y + 0.5 - cy)
                k += 1
    for k in np.argsort(gauges, kind="mergesort")[:n_missing]:
        occupied[cells[k, 0], cells[k, 1]] = True


@unchecked_division_kernel
def write_chords(
    slopes: NDArray[np.float64], first: int, last: int, cx: float, reach: float, rows: BlockRows
) -> None:
    """Write the lowest and highest y of a block in some rows; it has none where lowest > highest.

    Edge by edge: so the compiler divides for some rows at once.
    """
    low, high = rows.low[first : last + 1], rows.high[first : last + 1]
    low[:], high[:] = -reach, reach
    for edge in range(len(slopes)):
        along_x, along_y = slopes[edge, 0], slopes[edge, 1]
        if along_y > 0.0:
            for k in range(len(high)):
                end = (1.0 - along_x * (first + k + 0.5 - cx)) / along_y
                high[k] = end if end < high[k] else high[k]
        elif along_y < 0.0:
            for k in range(len(low)):
                end = (1.0 - along_x * (first + k + 0.5 - cx)) / along_y
                low[k] = end if end > low[k] else low[k]
        elif along_x != 0.0:
            for k in range(len(low)):
                if along_x * (first + k + 0.5 - cx) > 1.0:
                    low[k], high[k] = reach, -reach - 1.0


@borrowing_kernel
def gauge(slopes: NDArray[np.float64], x: float, y: float) -> float:
    """Gauge at (x, y) cells from the center of the block whose edges have these slopes (k, 2)."""
    largest = 0.0
    for edge in range(len(slopes)):
        largest = max(largest, slopes[edge, 0] * x + slopes[edge, 1] * y)
    return largest
