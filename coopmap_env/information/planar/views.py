"""Kernels over the cells that a pose would see on the known map.

A pose is a lattice number; `fan` is the tuple (start, offsets, beams, all_beams, reach) of a `BeamFan`.
A sampled cell with P >= 1/2 is taken as occupied and ends the beams that cross it; unknown cells
let them pass. `reserved_mask` marks cells that a teammate is about to see: they are not counted.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def are_all_below(numbers, n):
    """Whether every number lies in 0 ... n - 1."""
    outside = 0
    for k in range(len(numbers)):
        outside += numbers[k] < 0 or numbers[k] >= n
    return outside == 0


@njit(cache=True, nogil=True)
def largest_fan_size(fan):
    """Cells of the largest fan: as many as a view can show."""
    start = fan[0]
    most = 0
    for h in range(len(start) - 1):
        most = max(most, start[h + 1] - start[h])
    return most


@njit(cache=True, nogil=True)
def find_visible_cells(log_odds_fixed, sampled, nx, ny, pose, fan, alive, visible, entries):
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
        visible_beams = np.uint64(0)
        for w in range(words):
            visible_beams |= alive[w] & beams[k, w]
        if visible_beams == 0:
            continue
        seen = i * ny + j
        visible[count] = seen
        entries[count] = k
        count += 1
        if sampled[seen] and log_odds_fixed[seen] >= 0:
            left = np.uint64(0)
            for w in range(words):
                alive[w] &= ~beams[k, w]
                left |= alive[w]
            if left == 0:
                break
    return count


@njit(cache=True, nogil=True)
def view_information(
    log_odds_fixed, sampled, reserved_mask, visible, entries, n, gray, entropy_terms, counts
):
    """NI of one view, and its never-sampled cells.

    NI is the gray levels' histogram (Eqs. 7, 8), then H (Eq. 6) from a table. `gray` is (table,
    distance class, unknown bin, clamp); `counts` comes and goes as zeros.
    """
    table, distance_class, unknown_bin, clamp = gray
    unknown = 0
    for v in range(n):
        cell, k = visible[v], entries[v]
        if reserved_mask[cell]:
            continue
        if sampled[cell]:
            counts[table[distance_class[k], log_odds_fixed[cell] + clamp]] += 1
        else:
            counts[unknown_bin[k]] += 1
            unknown += 1
    h = 0.0
    for b in range(len(counts)):
        h += entropy_terms[counts[b]]
        counts[b] = 0
    return h, unknown


@njit(cache=True, nogil=True)
def evaluate_views(
    log_odds_fixed, sampled, reserved_mask, nx, ny, poses, fan, gray, entropy_terms, n_gray_bins, ni, unknown
):  # fmt: skip
    """NI (Eqs. 6-8) of each pose, and how many never-sampled cells it sees."""
    if len(fan[3]) == 1:
        _evaluate_views_64_beams(
            log_odds_fixed,
            sampled,
            reserved_mask,
            nx,
            ny,
            poses,
            fan,
            gray,
            entropy_terms,
            n_gray_bins,
            ni,
            unknown,
        )
        return
    size = largest_fan_size(fan)
    alive = np.empty(len(fan[3]), np.uint64)
    visible = np.empty(size, np.int64)
    entries = np.empty(size, np.int64)
    counts = np.zeros(n_gray_bins, np.int64)
    for p in range(len(poses)):
        n = find_visible_cells(
            log_odds_fixed, sampled, nx, ny, poses[p], fan, alive, visible, entries
        )
        ni[p], unknown[p] = view_information(
            log_odds_fixed, sampled, reserved_mask, visible, entries, n, gray, entropy_terms, counts
        )


@njit(cache=True, nogil=True)
def _evaluate_views_64_beams(
    log_odds_fixed,
    sampled,
    reserved_mask,
    nx,
    ny,
    poses,
    fan,
    gray,
    entropy_terms,
    n_gray_bins,
    ni,
    unknown,
):
    """`find_visible_cells` and `view_information` in one pass, for cameras whose beams fit one word.

    This is where planners spend their time; it takes a third of the two passes.
    """
    start, offsets, beams, all_beams, max_offset = fan
    table, distance_class, unknown_bin, clamp = gray
    n_headings = len(start) - 1
    counts = np.zeros(n_gray_bins, np.int64)
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        is_interior = max_offset <= x < nx - max_offset and max_offset <= y < ny - max_offset
        alive = all_beams[0]
        n_unknown = 0
        for entry in range(start[heading], start[heading + 1]):
            k = np.uint64(entry)  # the compiler guards signed indices against negative ones
            bits = beams[k, 0]
            if alive & bits == 0:
                continue
            i, j = x + offsets[k, 0], y + offsets[k, 1]
            if not is_interior and (i < 0 or i >= nx or j < 0 or j >= ny):
                continue
            seen = np.uint64(i * ny + j)
            if sampled[seen]:
                level = log_odds_fixed[seen]
                if not reserved_mask[seen]:
                    row, column = np.uint64(distance_class[k]), np.uint64(level + clamp)
                    counts[np.uint64(table[row, column])] += 1
                if level >= 0:
                    alive &= ~bits
                    if alive == 0:
                        break
            elif not reserved_mask[seen]:
                counts[np.uint64(unknown_bin[k])] += 1
                n_unknown += 1
        h = 0.0
        for b in range(n_gray_bins):
            h += entropy_terms[counts[b]]
            counts[b] = 0
        ni[p], unknown[p] = h, n_unknown


@njit(cache=True, nogil=True)
def sequential_new_information(
    log_odds_fixed,
    sampled,
    reserved_mask,
    nx,
    ny,
    poses,
    fan,
    gray,
    entropy_terms,
    n_gray_bins,
    out,
):
    """NI of each pose without what the poses before it see; leaves `reserved_mask` as it was (zeros)."""
    size = largest_fan_size(fan)
    alive = np.empty(len(fan[3]), np.uint64)
    visible = np.empty((len(poses), size), np.int64)
    entries = np.empty(size, np.int64)
    counts = np.zeros(n_gray_bins, np.int64)
    seen = np.zeros(len(poses), np.int64)
    for p in range(len(poses)):
        seen[p] = find_visible_cells(
            log_odds_fixed, sampled, nx, ny, poses[p], fan, alive, visible[p], entries
        )
        out[p], _ = view_information(
            log_odds_fixed,
            sampled,
            reserved_mask,
            visible[p],
            entries,
            seen[p],
            gray,
            entropy_terms,
            counts,
        )
        for v in range(seen[p]):
            reserved_mask[visible[p, v]] = 1
    for p in range(len(poses)):
        for v in range(seen[p]):
            reserved_mask[visible[p, v]] = 0


@njit(cache=True, nogil=True)
def rate_poses(
    log_odds_fixed, ny, poses, current, lattice, weights, probability, clamp, ni, d, cost, p, rating
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
        p[k] = probability[log_odds_fixed[cell] + clamp]
        cost[k] = K * (d[k] if exponent == 1.0 else d[k] ** exponent)  # a power costs 20 ns
        rating[k] = (ni[k] - cost[k]) * (1.0 - p[k])
