"""Kernels on what robots have truly shown, and where that lets them go."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.robots import LatticeGeometry
from coopmap_env.robots.planar.feasible_poses import PoseSampling
from coopmap_env.robots.planar.reachable_regions import neighbor
from coopmap_env.sensing.beam_fan import FanArrays
from coopmap_env.simulation.shown_cells import list_planar_view

HIDDEN, OCCUPIED, FREE = np.uint8(1), np.uint8(2), np.uint8(4)
"""Bits of a cell: not shown yet; truly occupied; truly free and known to be."""


class TrueWorld(NamedTuple):
    """What does not change in an episode."""

    occupied: NDArray[np.bool_]
    """Shape (n_cells,)."""
    fan: FanArrays
    sampling: PoseSampling


class Progress(NamedTuple):
    """How far a team has come."""

    cells: NDArray[np.uint8]
    """Bits of each cell (n_cells,)."""
    regions: NDArray[np.uint8]
    """1 in the cells (n_robots, n_cells) to which known free cells lead each robot."""
    pose_ids: NDArray[np.int64]
    """Shape (n_robots,)."""
    bounds: NDArray[np.int32]
    """At least as many cells (n_cells, n_headings) as each pose would newly show. That only falls,
    so counts of earlier steps will do."""
    gains: NDArray[np.int32]
    """The largest one of each cell (n_cells,)."""
    headings: NDArray[np.int16]
    """Its heading (n_cells,)."""
    counted_at: NDArray[np.int32]
    """Step (n_cells,) at which it was counted."""
    step: NDArray[np.int32]
    """Scans so far (1,), of all robots together."""

    @classmethod
    def empty(cls, n_cells: int, n_headings: int, n_robots: int) -> Progress:
        """Room for that of a team."""
        return cls(
            np.zeros(n_cells, np.uint8),
            np.zeros((n_robots, n_cells), np.uint8),
            np.zeros(n_robots, np.int64),
            np.zeros((n_cells, n_headings), np.int32),
            np.zeros(n_cells, np.int32),
            np.zeros(n_cells, np.int16),
            np.full(n_cells, -1, np.int32),
            np.zeros(1, np.int32),
        )


class Scratch(NamedTuple):
    """Memory of the kernels."""

    alive: NDArray[np.uint64]
    seen: NDArray[np.int32]
    """Room for the cells of the largest view."""
    queue: NDArray[np.int32]
    marks: NDArray[np.uint8]
    """Zeros (n_cells,), before and after."""
    rates: NDArray[np.float64]

    @classmethod
    def empty(cls, world: TrueWorld) -> Scratch:
        """For one thread."""
        n_cells = len(world.occupied)
        return cls(
            np.empty(len(world.fan.all_beams), np.uint64),
            np.empty(world.fan.max_visible_cells, np.int32),
            np.empty(n_cells, np.int32),
            np.zeros(n_cells, np.uint8),
            np.empty(n_cells),
        )


@inlined_kernel
def name_world(plain: PlainTuple) -> TrueWorld:
    """A plain `TrueWorld` with its names."""
    occupied, fan, (lattice, shape, reach) = plain
    return TrueWorld(
        occupied, FanArrays(*fan), PoseSampling(LatticeGeometry(*lattice), shape, reach)
    )


@borrowing_kernel
def count_view(
    cells: NDArray[np.uint8], world: TrueWorld, cell: int, heading: int, alive: NDArray[np.uint64]
) -> int:
    """How many hidden cells a scan from a pose shows."""
    nx, ny, _ = world.sampling.shape
    fan = world.fan
    margin, count = fan.max_offset, 0
    ix, iy = cell // ny, cell % ny
    is_inside = margin <= ix < nx - margin and margin <= iy < ny - margin
    k, end = fan.start[heading], fan.start[heading + 1]
    if is_inside:  # up to the first occupied cell, all are in view
        while k < end:
            bits = cells[np.uint64(cell + fan.flat_offsets[np.uint64(k)])]
            if bits & OCCUPIED:
                break
            count += bits & HIDDEN
            k += 1
    for word in range(len(alive)):
        alive[word] = fan.all_beams[word]
    for entry in range(k, end):
        e = np.uint64(entry)
        if not is_inside:
            i, j = ix + fan.offsets[e, 0], iy + fan.offsets[e, 1]
            if i < 0 or i >= nx or j < 0 or j >= ny:
                continue
        bits, is_seen = cells[np.uint64(cell + fan.flat_offsets[e])], False
        for word in range(len(alive)):
            crossing = alive[word] & fan.beams[word, e]
            is_seen |= crossing != 0
            if bits & OCCUPIED:
                alive[word] &= ~crossing
        if is_seen:
            count += bits & HIDDEN
    return count


@kernel
def count_views(
    cells: NDArray[np.uint8],
    plain_world: PlainTuple,
    pose_ids: NDArray[np.int64],
    counts: NDArray[np.int64],
) -> None:
    """Write how many hidden cells each of some poses (k,) shows."""
    world = name_world(plain_world)
    n_headings = world.sampling.lattice.n_headings
    alive = np.empty(len(world.fan.all_beams), np.uint64)
    for k in range(len(pose_ids)):
        counts[k] = count_view(
            cells, world, pose_ids[k] // n_headings, pose_ids[k] % n_headings, alive
        )


@borrowing_kernel
def count_again(progress: Progress, world: TrueWorld, cell: int, alive: NDArray[np.uint64]) -> None:
    """Count what the view from a cell shows that showed most; another may then show more."""
    bounds, heading = progress.bounds[cell], progress.headings[cell]
    count = count_view(progress.cells, world, cell, heading, alive)
    bounds[heading] = count
    progress.gains[cell] = count
    progress.counted_at[cell] = progress.step[0]
    for other in range(len(bounds)):
        if bounds[other] > progress.gains[cell]:
            progress.gains[cell], progress.headings[cell] = bounds[other], other
            progress.counted_at[cell] = -1


@borrowing_kernel
def _extend_region(
    cells: NDArray[np.uint8],
    region: NDArray[np.uint8],
    shape: tuple[int, int, int],
    n: int,
    queue: NDArray[np.int32],
) -> None:
    """Let a region grow from the first n cells of the queue, which belong to it."""
    head, tail = 0, n
    while head < tail:
        cell = int(queue[head])
        head += 1
        for side in range(4):
            beside = neighbor(cell, side, shape)
            if beside >= 0 and not region[beside] and cells[beside] & FREE:
                region[beside] = 1
                queue[tail] = beside
                tail += 1


@kernel
def find_region(
    cells: NDArray[np.uint8],
    region: NDArray[np.uint8],
    shape: tuple[int, int, int],
    start: int,
    queue: NDArray[np.int32],
) -> None:
    """Mark the cells (n_cells,) to which known free cells lead from a start, and the start."""
    region[:] = 0
    region[start] = 1
    queue[0] = start
    _extend_region(cells, region, shape, 1, queue)


@kernel
def mark_views(
    cells: NDArray[np.uint8],
    plain_world: PlainTuple,
    pose_ids: NDArray[np.int64],
    plain_scratch: PlainTuple,
) -> None:
    """The views from some poses (k,) are hidden no longer."""
    world, w = name_world(plain_world), Scratch(*plain_scratch)
    for pose_id in pose_ids:
        n = _list_view(world, pose_id, w)
        for k in range(n):
            cells[w.seen[k]] &= ~HIDDEN


@borrowing_kernel
def mark_scan(progress: Progress, world: TrueWorld, robot: int, pose_id: int, w: Scratch) -> int:
    """A robot goes to a pose and scans; return how many cells this newly shows.

    Where robots can go next, `open_scan` says when all have scanned.
    """
    n, count = _list_view(world, pose_id, w), 0
    for k in range(n):
        cell = np.uint64(w.seen[k])
        count += progress.cells[cell] & HIDDEN
        progress.cells[cell] &= ~HIDDEN
    progress.pose_ids[robot] = pose_id
    progress.step[0] += 1
    return count


@borrowing_kernel
def open_scan(progress: Progress, world: TrueWorld, pose_id: int, w: Scratch) -> None:
    """The free cells that a scan from a pose shows become known: all regions grow."""
    cells, shape = progress.cells, world.sampling.shape
    n = _list_view(world, pose_id, w)
    for k in range(n):
        if not cells[w.seen[k]] & OCCUPIED:
            cells[w.seen[k]] |= FREE
    for robot in range(len(progress.pose_ids)):
        region, n_new = progress.regions[robot], 0
        for k in range(n):
            cell = int(w.seen[k])
            if region[cell] or not cells[cell] & FREE:
                continue
            for side in range(4):
                beside = neighbor(cell, side, shape)
                if beside >= 0 and region[beside]:
                    region[cell] = 1
            if region[cell]:
                w.queue[n_new] = cell
                n_new += 1
        _extend_region(cells, region, shape, n_new, w.queue)


@borrowing_kernel
def _list_view(world: TrueWorld, pose_id: int, w: Scratch) -> int:
    """Write the cells that a scan from a pose shows; return how many they are."""
    (nx, ny, _), n_headings = world.sampling.shape, world.sampling.lattice.n_headings
    return list_planar_view(
        world.occupied, (nx, ny), pose_id // n_headings, pose_id % n_headings, world.fan, w.alive,
        w.seen,
    )  # fmt: skip
