"""Kernels over the cells that a pose would see on the known map.

A pose is a lattice number; `fan` is the tuple (start, offsets, beams, all_beams, reach) of a `Fan`.
A sampled cell with P >= 1/2 is taken as occupied and ends the beams that cross it; unknown cells
let them pass. `claimed` marks cells that a teammate is about to see: they are not counted.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def all_inside(numbers, n):
    """Whether every number lies in 0 ... n - 1."""
    outside = 0
    for k in range(len(numbers)):
        outside += numbers[k] < 0 or numbers[k] >= n
    return outside == 0


@njit(cache=True, nogil=True)
def most_visible(fan):
    """Cells of the largest fan: as many as a view can show."""
    start = fan[0]
    most = 0
    for h in range(len(start) - 1):
        most = max(most, start[h + 1] - start[h])
    return most


@njit(cache=True, nogil=True)
def view(levels, sampled, nx, ny, pose, fan, alive, visible, entries):
    """Write the visible cells and their entries in the fan; return how many there are."""
    start, offsets, beams, all_beams, _ = fan
    n_headings = len(start) - 1
    cell, heading = pose // n_headings, pose % n_headings
    x, y = cell // ny, cell % ny
    words = len(all_beams)
    for w in range(words):
        alive[w] = all_beams[w]
    count = 0
    for k in range(start[heading], start[heading + 1]):
        i, j = x + offsets[k, 0], y + offsets[k, 1]
        if i < 0 or i >= nx or j < 0 or j >= ny:
            continue
        lit = np.uint64(0)
        for w in range(words):
            lit |= alive[w] & beams[k, w]
        if lit == 0:
            continue
        seen = i * ny + j
        visible[count] = seen
        entries[count] = k
        count += 1
        if sampled[seen] and levels[seen] >= 0:
            left = np.uint64(0)
            for w in range(words):
                alive[w] &= ~beams[k, w]
                left |= alive[w]
            if left == 0:
                break
    return count


@njit(cache=True, nogil=True)
def entropy_of_view(levels, sampled, claimed, visible, entries, n, gray, minus_q_ln_q, counts):
    """NI of one view, and its never-sampled cells.

    NI is the gray levels' histogram (Eqs. 7, 8), then H (Eq. 6) from a table. `gray` is (table,
    distance class, unknown bin, clamp); `counts` comes and goes as zeros.
    """
    table, distance_class, unknown_bin, clamp = gray
    unknown = 0
    for v in range(n):
        cell, k = visible[v], entries[v]
        if claimed[cell]:
            continue
        if sampled[cell]:
            counts[table[distance_class[k], levels[cell] + clamp]] += 1
        else:
            counts[unknown_bin[k]] += 1
            unknown += 1
    h = 0.0
    for b in range(len(counts)):
        h += minus_q_ln_q[counts[b]]
        counts[b] = 0
    return h, unknown


@njit(cache=True, nogil=True)
def views(
    levels, sampled, claimed, nx, ny, poses, fan, gray, minus_q_ln_q, n_gray, ni, unknown
):  # fmt: skip
    """NI (Eqs. 6-8) of each pose, and how many never-sampled cells it sees."""
    if len(fan[3]) == 1:
        _views_of_64_beams(
            levels, sampled, claimed, nx, ny, poses, fan, gray, minus_q_ln_q, n_gray, ni, unknown
        )
        return
    size = most_visible(fan)
    alive = np.empty(len(fan[3]), np.uint64)
    visible = np.empty(size, np.int64)
    entries = np.empty(size, np.int64)
    counts = np.zeros(n_gray, np.int64)
    for p in range(len(poses)):
        n = view(levels, sampled, nx, ny, poses[p], fan, alive, visible, entries)
        ni[p], unknown[p] = entropy_of_view(
            levels, sampled, claimed, visible, entries, n, gray, minus_q_ln_q, counts
        )


@njit(cache=True, nogil=True)
def _views_of_64_beams(
    levels, sampled, claimed, nx, ny, poses, fan, gray, minus_q_ln_q, n_gray, ni, unknown
):
    """`view` and `entropy_of_view` in one pass, for cameras whose beams fit one word.

    This is where planners spend their time; it takes a third of the two passes.
    """
    start, offsets, beams, all_beams, reach = fan
    table, distance_class, unknown_bin, clamp = gray
    n_headings = len(start) - 1
    counts = np.zeros(n_gray, np.int64)
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        inland = reach <= x < nx - reach and reach <= y < ny - reach
        alive = all_beams[0]
        n_unknown = 0
        for entry in range(start[heading], start[heading + 1]):
            k = np.uint64(entry)  # the compiler guards signed indices against negative ones
            bits = beams[k, 0]
            if alive & bits == 0:
                continue
            i, j = x + offsets[k, 0], y + offsets[k, 1]
            if not inland and (i < 0 or i >= nx or j < 0 or j >= ny):
                continue
            seen = np.uint64(i * ny + j)
            if sampled[seen]:
                level = levels[seen]
                if not claimed[seen]:
                    row, column = np.uint64(distance_class[k]), np.uint64(level + clamp)
                    counts[np.uint64(table[row, column])] += 1
                if level >= 0:
                    alive &= ~bits
                    if alive == 0:
                        break
            elif not claimed[seen]:
                counts[np.uint64(unknown_bin[k])] += 1
                n_unknown += 1
        h = 0.0
        for b in range(n_gray):
            h += minus_q_ln_q[counts[b]]
            counts[b] = 0
        ni[p], unknown[p] = h, n_unknown


@njit(cache=True, nogil=True)
def new_information_in_turn(
    levels, sampled, claimed, nx, ny, poses, fan, gray, minus_q_ln_q, n_gray, out
):
    """NI of each pose without what the poses before it see; leaves `claimed` as it was (zeros)."""
    size = most_visible(fan)
    alive = np.empty(len(fan[3]), np.uint64)
    visible = np.empty((len(poses), size), np.int64)
    entries = np.empty(size, np.int64)
    counts = np.zeros(n_gray, np.int64)
    seen = np.zeros(len(poses), np.int64)
    for p in range(len(poses)):
        seen[p] = view(levels, sampled, nx, ny, poses[p], fan, alive, visible[p], entries)
        out[p], _ = entropy_of_view(
            levels, sampled, claimed, visible[p], entries, seen[p], gray, minus_q_ln_q, counts
        )
        for v in range(seen[p]):
            claimed[visible[p, v]] = 1
    for p in range(len(poses)):
        for v in range(seen[p]):
            claimed[visible[p, v]] = 0


@njit(cache=True, nogil=True)
def compose(
    levels, ny, poses, current, lattice, weights, probability, clamp, ni, d, cost, p, rating
):
    """Eqs. 5 and 9 of each pose from its NI; writes d, K d**n, P and RF.

    `current` holds one pose for each, or one for all; `lattice` is (headings, resolution);
    `weights` is (K, exponent, alpha position, alpha heading).
    """
    n_headings, resolution = lattice
    K, exponent, alpha_position, alpha_heading = weights
    turn = 2.0 * np.pi / n_headings
    for k in range(len(poses)):
        start = current[k] if len(current) > 1 else current[0]
        here, facing = start // n_headings, start % n_headings
        cell, heading = poses[k] // n_headings, poses[k] % n_headings
        dx = (cell // ny - here // ny) * resolution
        dy = (cell % ny - here % ny) * resolution
        turns = abs(heading - facing)
        angle = min(turns, n_headings - turns) * turn
        d[k] = np.sqrt(alpha_position * (dx * dx + dy * dy) + alpha_heading * angle * angle)
        p[k] = probability[levels[cell] + clamp]
        cost[k] = K * (d[k] if exponent == 1.0 else d[k] ** exponent)  # a power costs 20 ns
        rating[k] = (ni[k] - cost[k]) * (1.0 - p[k])
