"""Branch and bound over base poses: votes on a pooled likelihood field, less rays that see through.

Hess et al., "Real-time loop closure in 2D LIDAR SLAM" (2016), section V, with the best node first.
"""

from __future__ import annotations

import heapq
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.localization.registration._likelihood_field import FieldLevel
from coopmap_env.localization.registration.views import Beams

Array = NDArray[np.float64]

_MAX_MOVES = 6
"""Moves of a hypothesis in `hill_climb`: 0.6 m by the larger steps."""


class SearchGrid(NamedTuple):
    """Base poses that are searched: x and y on a square lattice, in a ring around the target."""

    n_steps: int
    """Nodes along x and y."""
    corner: Array
    """Shape (2,): first node, metres."""
    step: float
    """Metres between nodes."""
    yaws: Array
    """Headings, radians."""
    center: Array
    """Shape (2,): center of the target, metres."""
    min_distance: float
    """Metres from the center, inner radius of the ring."""
    max_distance: float
    """Metres from the center, outer radius of the ring."""


class SearchLimits(NamedTuple):
    """Which leaves are hypotheses, and when the search ends."""

    min_separation: tuple[float, float]
    """Metres and radians within which two leaves are the same."""
    min_score: float
    min_relative_score: float
    """Fraction of the best score."""
    max_leaves: int
    max_visits: int
    """Nodes that are visited."""


class Probes(NamedTuple):
    """Points of the target's surface that rays should not pass."""

    points: Array
    """Shape (n, 3), target frame, metres."""
    weight: float
    """Score that a probe costs which is seen through."""


@kernel
def points_to_cells(points: Array, grid: SearchGrid, field: FieldLevel) -> NDArray[np.int32]:
    """Cells (n_yaws, n, 3) of the field in which points (n, 3) lie, of bases at the corner."""
    yaws, corner, origin, cell = grid.yaws, grid.corner, field.origin, field.cell
    out = np.empty((len(yaws), len(points), 3), np.int32)
    for a in range(len(yaws)):
        s, c = sin_cos(yaws[a])
        for k in range(len(points)):
            x, y = points[k, 0], points[k, 1]
            out[a, k, 0] = np.int32(np.floor((c * x - s * y + corner[0] - origin[0]) / cell))
            out[a, k, 1] = np.int32(np.floor((s * x + c * y + corner[1] - origin[1]) / cell))
            out[a, k, 2] = np.int32(np.floor((points[k, 2] - origin[2]) / cell))
    return out


@kernel
def field_score(cells: NDArray[np.int32], values: NDArray[np.uint8], i: int, j: int) -> float:
    """Votes of points in `cells` (n, 3) on a field (nx, ny, nz), moved by (i, j) steps."""
    nx, ny, nz = values.shape
    total = 0
    for k in range(len(cells)):
        x, y, z = cells[k, 0] + 2 * i, cells[k, 1] + 2 * j, cells[k, 2]
        if 0 <= x < nx and 0 <= y < ny and 0 <= z < nz:
            total += values[x, y, z]
    return total / 255.0


@kernel
def count_seen_through(
    probes: Array, x: float, y: float, yaw: float, beams: Beams, stop_count: float
) -> int:
    """How many probes (n, 3) rays pass by more than the margin, with the base at x, y, yaw.

    Counting stops at `stop_count`.
    """
    min_ranges, R, t, (width, height, tan_x, tan_y), margin = beams
    s, c = sin_cos(yaw)
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
            col = int(np.floor(0.5 * width * (1.0 - py / (px * tan_x))))
            row = int(np.floor(0.5 * height * (1.0 - pz / (px * tan_y))))
            if not (0 <= col < width and 0 <= row < height):
                continue
            if min_ranges[w, row * width + col] > np.sqrt(dx * dx + dy * dy + dz * dz) + margin:
                count += 1
                break
        if count >= stop_count:
            break
    return count


@kernel
def best_first_search(
    cells: NDArray[np.int32],
    pooled: NDArray[np.uint8],
    grid: SearchGrid,
    probes: Probes,
    beams: Beams,
    limits: SearchLimits,
) -> tuple[Array, Array]:
    """The best distinct leaves [x, y, yaw] (k, 3) and their scores (k,), best first.

    A node is a square of 2^level x 2^level steps at one yaw; a leaf with its full score, rays
    included, has level -1. Leaves outside of the ring, or near to a better one, are dropped.
    """
    top = len(pooled) - 1
    size = 1 << top
    found, scores, count = np.empty((limits.max_leaves, 3)), np.empty(limits.max_leaves), 0
    heap = [(0.0, 0, 0, 0, 0)]
    heap.pop()
    for a in range(len(grid.yaws)):
        for i in range(0, grid.n_steps, size):
            for j in range(0, grid.n_steps, size):
                if _reaches_ring(grid, i, j, size):
                    bound = field_score(cells[a], pooled[top], i, j)
                    if bound > limits.min_score:
                        heap.append((-bound, top, a, i, j))
    heapq.heapify(heap)
    for _ in range(limits.max_visits):
        if not heap or count == limits.max_leaves:
            break
        value, level, a, i, j = heapq.heappop(heap)
        if count > 0 and -value < limits.min_relative_score * scores[0]:
            break
        if level > 0:
            side = 1 << (level - 1)
            for ci in (i, i + side):
                for cj in (j, j + side):
                    if _reaches_ring(grid, ci, cj, side):
                        bound = field_score(cells[a], pooled[level - 1], ci, cj)
                        if bound > limits.min_score:
                            heapq.heappush(heap, (-bound, level - 1, a, ci, cj))
            continue
        x, y, yaw = grid.corner[0] + i * grid.step, grid.corner[1] + j * grid.step, grid.yaws[a]
        if _is_duplicate(found, count, x, y, yaw, limits.min_separation):
            continue
        if level == 0:
            needed = limits.min_score
            if count > 0:
                needed = max(needed, limits.min_relative_score * scores[0])
            stop_count = (-value - needed) / probes.weight  # more, and it is no hypothesis
            n_passed = count_seen_through(probes.points, x, y, yaw, beams, stop_count)
            if n_passed < stop_count:
                heapq.heappush(heap, (value + probes.weight * n_passed, -1, a, i, j))
            continue
        found[count, 0], found[count, 1], found[count, 2] = x, y, yaw
        scores[count] = -value
        count += 1
    return found[:count], scores[:count]


@kernel
def hill_climb(
    found: Array,
    scores: Array,
    points: Array,
    field: FieldLevel,
    steps: tuple[float, float],
    probes: Probes,
    beams: Beams,
) -> None:
    """Move hypotheses [x, y, yaw] (k, 3) to the best of their neighbours, until none is better.

    Neighbours are up to two steps away in x and y and one in yaw; the steps are in metres and
    radians. In place; the scores become those on this field.
    """
    for h in range(len(found)):
        best, improved = -np.inf, True
        for _ in range(_MAX_MOVES):
            if not improved:
                break
            improved = False
            x0, y0, yaw0 = found[h, 0], found[h, 1], found[h, 2]
            for a in range(-1, 2):
                yaw = yaw0 + a * steps[1]
                for i in range(-2, 3):
                    for j in range(-2, 3):
                        x, y = x0 + i * steps[0], y0 + j * steps[0]
                        value = _votes(points, x, y, yaw, field)
                        if value <= best:
                            continue
                        stop_count = (value - best) / probes.weight
                        n_passed = count_seen_through(probes.points, x, y, yaw, beams, stop_count)
                        value -= probes.weight * n_passed
                        if value > best:
                            best = value
                            found[h, 0], found[h, 1], found[h, 2] = x, y, yaw
                            improved = i != 0 or j != 0 or a != 0 or improved
        scores[h] = best


@kernel
def _votes(points: Array, x: float, y: float, yaw: float, field: FieldLevel) -> float:
    """Votes of points (n, 3) on a field, with the base at x, y, yaw."""
    nx, ny, nz = field.values.shape
    origin, cell = field.origin, field.cell
    s, c = sin_cos(yaw)
    total = 0
    for k in range(len(points)):
        u, v = points[k, 0], points[k, 1]
        p = int(np.floor((c * u - s * v + x - origin[0]) / cell))
        q = int(np.floor((s * u + c * v + y - origin[1]) / cell))
        r = int(np.floor((points[k, 2] - origin[2]) / cell))
        if 0 <= p < nx and 0 <= q < ny and 0 <= r < nz:
            total += field.values[p, q, r]
    return total / 255.0


@inlined_kernel
def _reaches_ring(grid: SearchGrid, i: int, j: int, size: int) -> bool:
    """Whether a square of leaves may have one in the ring."""
    corner, step, center = grid.corner, grid.step, grid.center
    x0, x1 = corner[0] + i * step - center[0], corner[0] + (i + size - 1) * step - center[0]
    y0, y1 = corner[1] + j * step - center[1], corner[1] + (j + size - 1) * step - center[1]
    near_x, near_y = max(x0, -x1, 0.0), max(y0, -y1, 0.0)
    far_x, far_y = max(abs(x0), abs(x1)), max(abs(y0), abs(y1))
    near, far = np.hypot(near_x, near_y), np.hypot(far_x, far_y)
    return bool(near <= grid.max_distance and far >= grid.min_distance)


@kernel
def _is_duplicate(
    found: Array, count: int, x: float, y: float, yaw: float, separation: tuple[float, float]
) -> bool:
    """Whether one of the first `count` leaves is within a separation in metres and radians."""
    for k in range(count):
        difference = abs(yaw - found[k, 2])
        difference = min(difference, 2.0 * np.pi - difference)
        distance = np.hypot(x - found[k, 0], y - found[k, 1])
        if distance < separation[0] and difference < separation[1]:
            return True
    return False
