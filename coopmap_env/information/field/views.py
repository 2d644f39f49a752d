"""Kernels over the voxels that camera poses would see on the known map, in space.

First the depth buffer of the pose, then one pass along the runs of its frustum: a voxel is visible
if its depth is within the limit of its pixel. Sparse rays would miss half of the visible voxels,
dense ones cost six times as much.

`map_arrays` is the tuple (levels, sampled, claimed, shape), `occluder_spheres` (centres, radii) of spheres in
cells, `camera_arrays` (lens, directions, most runs), `gray` (table, distance class, unknown bin, clamp),
the second and third by the squared distance in quarters of a cell. Positions are in cells.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from coopmap_env.information.field.depth_buffer import depth_limits, is_outside, occluder_bounds
from coopmap_env.information.field.frustum import frustum_runs, projection_rows

MIN_VIEWS_FOR_BOX = 8
"""Poses for which it pays to find the box of the occluders: 200 us against 50 us each."""


@njit(cache=True, nogil=True)
def allocate_view(camera_arrays):
    """Arrays that hold one view: ray distances, limits, runs, starts."""
    projection, directions, max_runs = camera_arrays
    w, h = projection[4], projection[5]
    return (
        np.empty(len(directions)),
        np.empty((w + 1) * (h + 1)),
        np.empty((max_runs, 2), np.int64),
        np.empty((max_runs, 5)),
    )


@njit(cache=True, nogil=True)
def unbounded_box():
    """A box (2, 3) without ends."""
    box = np.empty((2, 3))
    box[0], box[1] = -np.inf, np.inf
    return box


@njit(cache=True, nogil=True)
def trace_view(map_arrays, box, position, R, occluder_spheres, camera_arrays, work):
    """Fill depth limits and runs of a pose; return the number of runs and a step in z.

    All occluding voxels lie in the `box`.
    """
    log_odds_fixed, sampled, _, shape = map_arrays
    projection, directions, _ = camera_arrays
    distances, limits, runs, starts = work
    forms = projection_rows(R, projection)
    if is_outside(shape, position):
        return 0, forms[:, 2]
    depth_limits(
        log_odds_fixed, sampled, shape, box, position, R, projection, directions,
        occluder_spheres[0], occluder_spheres[1], distances, limits,
    )  # fmt: skip
    return frustum_runs(shape, position, R, forms, projection, runs, starts), forms[:, 2]


@njit(cache=True, nogil=True, error_model="numpy")  # 1 / X unasked
def _add_to_histogram(map_arrays, n, step, stride, work, gray, counts):
    """Add one view to its histogram (see `histograms`)."""
    log_odds_fixed, sampled, reserved_mask, _ = map_arrays
    table, distance_class, unknown_bin, clamp = gray
    _, limits, runs, starts = work
    n_gray_bins = len(counts) // 2
    step_x, step_u, step_v = step[0], step[1], step[2]
    for r in range(n):
        X, U, V, up, flat2 = starts[r, 0], starts[r, 1], starts[r, 2], starts[r, 3], starts[r, 4]
        first = np.uint64(runs[r, 0])  # the compiler guards signed indices against negative ones
        for cell in range(first, first + np.uint64(runs[r, 1])):
            inverse = 1.0 / X
            depth = limits[np.uint64(int(U * inverse) * stride + int(V * inverse))]
            if depth >= X:  # noqa: SIM102 - nested is faster
                if not reserved_mask[cell]:
                    d = np.uint64(up * up + flat2)
                    if sampled[cell]:
                        row, column = (
                            np.uint64(distance_class[d]),
                            np.uint64(log_odds_fixed[cell] + clamp),
                        )
                        counts[np.uint64(table[row, column])] += 1
                    else:
                        counts[np.uint64(n_gray_bins + unknown_bin[d])] += 1
            X += step_x
            U += step_u
            V += step_v
            up += 2.0


@njit(cache=True, nogil=True)
def histograms(map_arrays, positions, rotations, occluder_spheres, camera_arrays, gray, out):
    """Histogram of the gray levels that each pose sees (Eqs. 7, 8), shape (k, 2 n_gray_bins).

    Sampled voxels in the first half of a row, never-sampled ones in the second: the bins of Eq. 7
    are the sum of both.
    """
    work = allocate_view(camera_arrays)
    stride = camera_arrays[0][5] + 1
    box = unbounded_box()
    if len(positions) >= MIN_VIEWS_FOR_BOX:
        occluder_bounds(map_arrays[0], map_arrays[1], map_arrays[3], box)
    for p in range(len(positions)):
        for b in range(out.shape[1]):
            out[p, b] = 0
        n, step = trace_view(
            map_arrays, box, positions[p], rotations[p], occluder_spheres, camera_arrays, work
        )
        _add_to_histogram(map_arrays, n, step, stride, work, gray, out[p])


@njit(cache=True, nogil=True, error_model="numpy")  # 1 / X unasked
def view(map_arrays, position, R, occluder_spheres, camera_arrays):
    """Visible voxels of one pose: flat numbers, and squared distances in quarters of a cell."""
    work = allocate_view(camera_arrays)
    _, limits, runs, starts = work
    stride = camera_arrays[0][5] + 1
    n, step = trace_view(
        map_arrays, unbounded_box(), position, R, occluder_spheres, camera_arrays, work
    )
    size = 0
    for r in range(n):
        size += runs[r, 1]
    cells, distances = np.empty(size, np.int32), np.empty(size, np.int32)
    count = 0
    for r in range(n):
        X, U, V, up, flat2 = starts[r, 0], starts[r, 1], starts[r, 2], starts[r, 3], starts[r, 4]
        first = runs[r, 0]
        for cell in range(first, first + runs[r, 1]):
            inverse = 1.0 / X
            cells[count], distances[count] = cell, int(up * up + flat2)
            # the next one is written over it unless it is seen
            count += limits[int(U * inverse) * stride + int(V * inverse)] >= X
            X += step[0]
            U += step[1]
            V += step[2]
            up += 2.0
    return cells[:count], distances[:count]


@njit(cache=True, nogil=True)
def view_histogram(map_arrays, cells, distances, gray, counts):
    """As `histograms`, from a view that is known already."""
    log_odds_fixed, sampled, reserved_mask, _ = map_arrays
    table, distance_class, unknown_bin, clamp = gray
    n_gray_bins = len(counts) // 2
    for v in range(len(cells)):
        cell, d = cells[v], distances[v]
        if not reserved_mask[cell]:
            if sampled[cell]:
                counts[table[distance_class[d], log_odds_fixed[cell] + clamp]] += 1
            else:
                counts[n_gray_bins + unknown_bin[d]] += 1


@njit(cache=True, nogil=True)
def fill_mask(reserved_mask, cells, value):
    """Write 1 or 0 at the cells of a view; NumPy takes five times as long with 32-bit numbers."""
    for cell in cells:
        reserved_mask[np.uint64(cell)] = value


@njit(cache=True, nogil=True)
def entropies(histogram, entropy_terms, out):
    """NI of each row of `histograms` (Eq. 6); a bin of N or more holds all, and tells nothing."""
    n_gray_bins = histogram.shape[1] // 2
    full = len(entropy_terms) - 1
    for p in range(len(histogram)):
        h = 0.0
        for b in range(n_gray_bins):
            h += entropy_terms[min(histogram[p, b] + histogram[p, n_gray_bins + b], full)]
        out[p] = h
