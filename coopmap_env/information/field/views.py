"""Kernels over the voxels that camera poses would see on the known map.

First the depth buffer of the pose, then one pass along the runs of its frustum: a voxel is visible
if its depth is within the limit of its pixel. Sparse rays would miss visible voxels, and dense ones
are slower.

All lengths are in cells of the grid. The tables of `GrayBins` are indexed by the squared distance
in quarters of a squared cell. `reserved_mask` is 1 at voxels that are not counted; Eq. 7 treats
them as hidden ones.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel, unchecked_division_kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field._depth_buffer import (
    CameraArrays,
    SphereArrays,
    depth_limits,
    is_outside,
    occluder_bounds,
)
from coopmap_env.information.field.frustum import FrustumRuns, frustum_runs, projection_rows
from coopmap_env.information.gray_levels import GrayBins, histogram_entropy
from coopmap_env.mapping import MapArrays

MIN_VIEWS_FOR_BOX = 8
"""Views from which on it pays to find the box of the occluders first."""


class PoseArrays(NamedTuple):
    """Camera poses on a grid."""

    rotations: NDArray[np.float64]
    """R_world_camera (k, 3, 3)."""
    positions: NDArray[np.float64]
    """Shape (k, 3), cells."""


class ViewBuffers(NamedTuple):
    """Scratch of one view."""

    distances: NDArray[np.float64]
    """Distance to the first occluder along the ray of each pixel (width height,)."""
    limits: NDArray[np.float64]
    """Depth down to which each pixel sees ((width + 1) (height + 1),); see `depth_limits`."""
    runs: FrustumRuns


@kernel
def allocate_view(camera: CameraArrays) -> ViewBuffers:
    """Scratch for the views of a camera."""
    frustum, n = camera.frustum, camera.max_runs
    runs = FrustumRuns(
        np.empty(n, np.int64), np.empty(n, np.int64),
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
    )  # fmt: skip
    return ViewBuffers(
        np.empty(len(camera.directions)), np.empty((frustum.width + 1) * (frustum.height + 1)), runs
    )


@kernel
def unbounded_box() -> NDArray[np.float64]:
    """A box (2, 3) without ends."""
    box = np.empty((2, 3))
    box[0], box[1] = -np.inf, np.inf
    return box


@kernel
def trace_view(
    arrays: MapArrays,
    box: NDArray[np.float64],
    pose: RigidTransform,
    spheres: SphereArrays,
    camera: CameraArrays,
    view: ViewBuffers,
) -> tuple[int, NDArray[np.float64]]:
    """Fill depth limits and runs of a pose; return the number of runs, and dX, dU, dV by z.

    The `box` (2, 3) contains all occluding voxels.
    """
    rows = projection_rows(pose.rotation, camera.frustum)
    if is_outside(arrays.shape, pose.translation):
        return 0, rows[:, 2]
    depth_limits(arrays, box, pose, camera, spheres, view.distances, view.limits)
    return frustum_runs(arrays.shape, pose, rows, camera.frustum, view.runs), rows[:, 2]


@inlined_kernel
def _quarters(half_height: float, horizontal_quarters: float) -> np.uint64:
    """Index of a voxel's distance in tables.

    By way of a signed number: from a float to an unsigned one takes several times as long.
    """
    return np.uint64(np.uint32(np.int32(half_height * half_height + horizontal_quarters)))


@unchecked_division_kernel
def _add_to_histogram(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    n: int,
    step: NDArray[np.float64],
    stride: int,
    view: ViewBuffers,
    gray: GrayBins,
    counts: NDArray[np.int64],
) -> None:
    """Add one view of n runs to its histogram (see `write_histograms`)."""
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    table, distance_class, unknown_bin = gray.sampled, gray.distance_class, gray.unknown
    limits, runs = view.limits, view.runs
    n_gray_bins = len(counts) // 2
    step_x, step_u, step_v = step[0], step[1], step[2]
    has_classes = len(table) > 1
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        half_height, horizontal = runs.half_height[r], runs.horizontal_quarters[r]
        first = np.uint64(runs.first[r])
        for cell in range(first, first + np.uint64(runs.length[r])):
            inverse = 1.0 / X
            depth = limits[np.uint64(int(U * inverse) * stride + int(V * inverse))]
            if depth >= X:  # noqa: SIM102 - nested is faster
                if not reserved_mask[cell]:
                    if sampled[cell]:
                        row = np.uint64(0)
                        if has_classes:
                            row = np.uint64(distance_class[_quarters(half_height, horizontal)])
                        column = np.uint64(log_odds_fixed[cell] + clamp)
                        counts[np.uint64(table[row, column])] += 1
                    else:
                        quarters = _quarters(half_height, horizontal)
                        counts[np.uint64(n_gray_bins + unknown_bin[quarters])] += 1
            X += step_x
            U += step_u
            V += step_v
            half_height += 2.0


@kernel
def write_histograms(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    poses: PoseArrays,
    spheres: SphereArrays,
    camera: CameraArrays,
    gray: GrayBins,
    out: NDArray[np.int64],
) -> None:
    """Write the histogram of the gray levels that each pose sees (Eqs. 7, 8), (k, 2 n_gray_bins).

    Sampled voxels are in the first half of a row, never-sampled ones in the second: the bins of
    Eq. 7 are the sum of both.
    """
    view = allocate_view(camera)
    stride = camera.frustum.height + 1
    box = unbounded_box()
    if len(poses.positions) >= MIN_VIEWS_FOR_BOX:
        occluder_bounds(arrays, box)
    for p in range(len(poses.positions)):
        for b in range(out.shape[1]):
            out[p, b] = 0
        pose = RigidTransform(poses.rotations[p], poses.positions[p])
        n, step = trace_view(arrays, box, pose, spheres, camera, view)
        _add_to_histogram(arrays, reserved_mask, n, step, stride, view, gray, out[p])


@unchecked_division_kernel
def find_visible_voxels(
    arrays: MapArrays, pose: RigidTransform, spheres: SphereArrays, camera: CameraArrays
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Visible voxels of one pose: flat indices, and squared distances in quarters."""
    view = allocate_view(camera)
    limits, runs = view.limits, view.runs
    stride = camera.frustum.height + 1
    n, step = trace_view(arrays, unbounded_box(), pose, spheres, camera, view)
    size = 0
    for r in range(n):
        size += runs.length[r]
    cells, distances = np.empty(size, np.int32), np.empty(size, np.int32)
    count = 0
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        half_height, horizontal = runs.half_height[r], runs.horizontal_quarters[r]
        for cell in range(runs.first[r], runs.first[r] + runs.length[r]):
            inverse = 1.0 / X
            cells[count], distances[count] = cell, int(half_height * half_height + horizontal)
            # the next one is written over it unless it is visible
            count += limits[int(U * inverse) * stride + int(V * inverse)] >= X
            X += step[0]
            U += step[1]
            V += step[2]
            half_height += 2.0
    return cells[:count], distances[:count]


@kernel
def view_histogram(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    cells: NDArray[np.int32],
    distances: NDArray[np.int32],
    gray: GrayBins,
    counts: NDArray[np.int64],
) -> None:
    """As `write_histograms`, from the voxels of a view that is known already."""
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    n_gray_bins = len(counts) // 2
    for v in range(len(cells)):
        cell, d = cells[v], distances[v]
        if not reserved_mask[cell]:
            if sampled[cell]:
                counts[gray.sampled[gray.distance_class[d], log_odds_fixed[cell] + clamp]] += 1
            else:
                counts[n_gray_bins + gray.unknown[d]] += 1


@kernel
def fill_mask(mask: NDArray[np.uint8], cells: NDArray[np.int32], value: int) -> None:
    """Write 1 or 0 at the cells of a view; NumPy takes five times as long with 32-bit indices."""
    for cell in cells:
        mask[np.uint64(cell)] = value


@kernel
def write_entropies(histogram: NDArray[np.int64], gray: GrayBins, out: NDArray[np.float64]) -> None:
    """Write NI (Eqs. 6 and 7) of each row of `write_histograms`."""
    counts = np.empty(gray.n_bins, np.int64)
    for p in range(len(histogram)):
        for b in range(gray.n_bins):
            counts[b] = histogram[p, b] + histogram[p, gray.n_bins + b]
        out[p] = histogram_entropy(counts, gray)
