"""Kernels of the search: votes on a pooled field, beams that see through, and the tree of poses.

Hess et al., "Real-time loop closure in 2D LIDAR SLAM" (2016), section V, with the best node first.
"""

import heapq

import numpy as np
from numba import njit

_MAX_MOVES = 6
"""Moves of a hypothesis at most: 0.6 m by the larger steps."""


@njit(cache=True, nogil=True)
def points_to_cells(points, yaws, corner, origin, cell):
    """Cells (yaws, n, 3) of the field in which points (n, 3) lie, of bases at the corner."""
    out = np.empty((len(yaws), len(points), 3), np.int32)
    for a in range(len(yaws)):
        c, s = np.cos(yaws[a]), np.sin(yaws[a])
        for k in range(len(points)):
            x, y = points[k, 0], points[k, 1]
            out[a, k, 0] = np.int32(np.floor((c * x - s * y + corner[0] - origin[0]) / cell))
            out[a, k, 1] = np.int32(np.floor((s * x + c * y + corner[1] - origin[1]) / cell))
            out[a, k, 2] = np.int32(np.floor((points[k, 2] - origin[2]) / cell))
    return out


@njit(cache=True, nogil=True)
def field_score(cells, field, i, j):
    """Votes of points in `cells` (n, 3) on a field (nx, ny, nz), moved by (i, j) steps."""
    nx, ny, nz = field.shape
    total = 0
    for k in range(len(cells)):
        x, y, z = cells[k, 0] + 2 * i, cells[k, 1] + 2 * j, cells[k, 2]
        if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
            total += field[x, y, z]
    return total / 255.0


@njit(cache=True, nogil=True)
def count_seen_through(probes, x, y, yaw, min_ranges, R, t, intrinsics, margin, stop_count):
    """How many probes (n, 3) beams pass by more than a margin, if the base stands at x, y, yaw.

    Counting stops at `stop_count`.
    """
    width, height, left, top = intrinsics
    c, s = np.cos(yaw), np.sin(yaw)
    count = 0
    for k in range(len(probes)):
        u, v, z = probes[k, 0] - x, probes[k, 1] - y, probes[k, 2]
        bx, by = c * u + s * v, c * v - s * u
        for w in range(len(t)):
            dx, dy, dz = bx - t[w, 0], by - t[w, 1], z - t[w, 2]
            px = R[w, 0, 0] * dx + R[w, 1, 0] * dy + R[w, 2, 0] * dz
            if px <= 0.0:
                continue
            py = R[w, 0, 1] * dx + R[w, 1, 1] * dy + R[w, 2, 1] * dz
            pz = R[w, 0, 2] * dx + R[w, 1, 2] * dy + R[w, 2, 2] * dz
            col = int(np.floor(0.5 * width * (1.0 - py / (px * left))))
            row = int(np.floor(0.5 * height * (1.0 - pz / (px * top))))
            if not (0 <= col < width and 0 <= row < height):
                continue
            if min_ranges[w, row * width + col] > np.sqrt(dx * dx + dy * dy + dz * dz) + margin:
                count += 1
                break
        if count >= stop_count:
            break
    return count


@njit(cache=True, nogil=True)
def best_first_search(
    cells, pooled_fields, n_steps, corner, step, center_xy, distance_range, yaws, probes, min_ranges, R, t, intrinsics, margin,
    probe_weight, min_separation, min_score, min_relative_score, max_leaves, max_visits,
):  # fmt: skip
    """The best distinct leaves [x, y, yaw] (k, 3) and their scores (k,), best first.

    A node is a square of 2^level x 2^level steps at one yaw; a leaf with its full score, beams
    included, has level -1. Leaves whose base stands outside of the ring (least, largest distance
    from the middle), or near to a better one, are dropped.
    """
    top = len(pooled_fields) - 1
    size = 1 << top
    found = np.empty((max_leaves, 3))
    scores = np.empty(max_leaves)
    count = 0
    heap = [(0.0, 0, 0, 0, 0)]
    heap.pop()
    for a in range(len(yaws)):
        for i in range(0, n_steps, size):
            for j in range(0, n_steps, size):
                near, far = _distance_bounds(i, j, size, corner, step, center_xy)
                if near > distance_range[1] or far < distance_range[0]:
                    continue
                bound = field_score(cells[a], pooled_fields[top], i, j)
                if bound > min_score:
                    heap.append((-bound, top, a, i, j))
    heapq.heapify(heap)
    for _ in range(max_visits):
        if not heap or count == max_leaves:
            break
        value, level, a, i, j = heapq.heappop(heap)
        if count > 0 and -value < min_relative_score * scores[0]:
            break
        x, y = corner[0] + i * step, corner[1] + j * step
        if level > 0:
            side = 1 << (level - 1)
            for di in range(2):
                for dj in range(2):
                    ci, cj = i + di * side, j + dj * side
                    near, far = _distance_bounds(ci, cj, side, corner, step, center_xy)
                    if near > distance_range[1] or far < distance_range[0]:
                        continue
                    bound = field_score(cells[a], pooled_fields[level - 1], ci, cj)
                    if bound > min_score:
                        heapq.heappush(heap, (-bound, level - 1, a, ci, cj))
            continue
        is_duplicate = False
        for k in range(count):
            yaw_difference = abs(yaws[a] - found[k, 2])
            yaw_difference = min(yaw_difference, 2.0 * np.pi - yaw_difference)
            if (
                np.hypot(x - found[k, 0], y - found[k, 1]) < min_separation[0]
                and yaw_difference < min_separation[1]
            ):
                is_duplicate = True
                break
        if is_duplicate:
            continue
        if level == 0:
            needed = max(min_score, min_relative_score * scores[0]) if count > 0 else min_score
            stop_count = (-value - needed) / probe_weight  # more, and it is no hypothesis
            n_seen_through = count_seen_through(
                probes, x, y, yaws[a], min_ranges, R, t, intrinsics, margin, stop_count
            )
            if n_seen_through < stop_count:
                heapq.heappush(heap, (value + probe_weight * n_seen_through, -1, a, i, j))
            continue
        found[count, 0], found[count, 1], found[count, 2] = x, y, yaws[a]
        scores[count] = -value
        count += 1
    return found[:count], scores[:count]


@njit(cache=True, nogil=True)
def hill_climb(
    found, scores, points, field, origin, cell, step, yaw_step, probes, min_ranges, R, t, intrinsics, margin,
    probe_weight,
):  # fmt: skip
    """Move hypotheses [x, y, yaw] (k, 3) to the best of those around, until none is better.

    Neighbours are up to two steps away in x and y and one in yaw. In place; scores become those on
    this field (nx, ny, nz).
    """
    n = len(points)
    nx, ny, nz = field.shape
    for h in range(len(found)):
        best, improved = -np.inf, True
        for _ in range(_MAX_MOVES):
            if not improved:
                break
            improved = False
            x0, y0, yaw0 = found[h, 0], found[h, 1], found[h, 2]
            for a in range(-1, 2):
                yaw = yaw0 + a * yaw_step
                c, s = np.cos(yaw), np.sin(yaw)
                for i in range(-2, 3):
                    for j in range(-2, 3):
                        x, y = x0 + i * step, y0 + j * step
                        total = 0
                        for k in range(n):
                            u, v = points[k, 0], points[k, 1]
                            p = int(np.floor((c * u - s * v + x - origin[0]) / cell))
                            q = int(np.floor((s * u + c * v + y - origin[1]) / cell))
                            r = int(np.floor((points[k, 2] - origin[2]) / cell))
                            if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
                                total += field[p, q, r]
                        value = total / 255.0
                        if value <= best:
                            continue
                        value -= probe_weight * count_seen_through(
                            probes,
                            x,
                            y,
                            yaw,
                            min_ranges,
                            R,
                            t,
                            intrinsics,
                            margin,
                            (value - best) / probe_weight,
                        )
                        if value > best:
                            best = value
                            found[h, 0], found[h, 1], found[h, 2] = x, y, yaw
                            improved = i != 0 or j != 0 or a != 0 or improved
        scores[h] = best


@njit(cache=True, nogil=True)
def _distance_bounds(i, j, size, corner, step, center_xy):
    """Least and largest distance of a square of leaves from the target's middle."""
    x0, x1 = corner[0] + i * step - center_xy[0], corner[0] + (i + size - 1) * step - center_xy[0]
    y0, y1 = corner[1] + j * step - center_xy[1], corner[1] + (j + size - 1) * step - center_xy[1]
    near_x, near_y = max(x0, -x1, 0.0), max(y0, -y1, 0.0)
    far_x, far_y = max(abs(x0), abs(x1)), max(abs(y0), abs(y1))
    return np.hypot(near_x, near_y), np.hypot(far_x, far_y)
