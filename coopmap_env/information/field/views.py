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

from coopmap_env.core.kernels import (
    borrowing_kernel,
    inlined_kernel,
    kernel,
    unchecked_division_kernel,
)
from coopmap_env.geometry import RigidTransform
from coopmap_env.information.field._depth_buffer import (
    CameraArrays,
    DepthBuffer,
    SphereArrays,
    depth_limits,
    is_outside,
)
from coopmap_env.information.field._near_occluders import BATCH
from coopmap_env.information.field.frustum import projection_rows
from coopmap_env.information.field.frustum_runs import FrustumRuns, frustum_runs
from coopmap_env.information.gray_levels import GrayBins, histogram_entropy
from coopmap_env.mapping import MapArrays
from coopmap_env.mapping.occluders import ViewedMap


class PoseArrays(NamedTuple):
    """Camera poses on a grid."""

    rotations: NDArray[np.float64]
    """R_world_camera (k, 3, 3)."""
    positions: NDArray[np.float64]
    """Shape (k, 3), cells."""


class ViewBuffers(NamedTuple):
    """Scratch of one view."""

    depth: DepthBuffer
    runs: FrustumRuns


@kernel
def allocate_view(camera: CameraArrays) -> ViewBuffers:
    """Scratch for the views of a camera."""
    frustum, n, n_pixels = camera.frustum, camera.max_runs, len(camera.directions)
    runs = FrustumRuns(
        np.empty(n, np.int64), np.empty(n, np.int64),
        np.empty(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n),
    )  # fmt: skip
    buffer = DepthBuffer(
        np.empty(BATCH + camera.max_row, np.int32),
        np.empty((3, n_pixels)),
        np.empty(n_pixels),
        np.empty((frustum.width + 1) * (frustum.height + 1)),
        frustum.height + 1,
    )
    return ViewBuffers(buffer, runs)


@kernel
def trace_view(
    viewed: ViewedMap,
    pose: RigidTransform,
    spheres: SphereArrays,
    camera: CameraArrays,
    view: ViewBuffers,
) -> tuple[int, NDArray[np.float64]]:
    """Fill depth limits and runs of a pose; return the number of runs, and dX, dU, dV by z."""
    rows, shape = projection_rows(pose.rotation, camera.frustum), viewed.arrays.shape
    if is_outside(shape, pose.translation):
        return 0, rows[:, 2]
    depth_limits(viewed, pose, rows, camera, spheres, view.depth)
    return frustum_runs(shape, pose, rows, camera.frustum, view.runs), rows[:, 2]


@inlined_kernel
def _quarters(half_height: float, horizontal_quarters: float) -> np.uint64:
    """Index of a voxel's distance in tables.

    By way of a signed number: from a float to an unsigned one takes several times as long.
    """
    return np.uint64(np.uint32(np.int32(half_height * half_height + horizontal_quarters)))


@unchecked_division_kernel
def _count_voxels(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    n: int,
    step: NDArray[np.float64],
    view: ViewBuffers,
    gray: GrayBins,
    counts: NDArray[np.int64],
    seen: NDArray[np.uint8],
) -> None:
    """Add the visible voxels of n runs to the histogram of their gray levels (Eqs. 7, 8).

    Sampled voxels are counted in the first half of `counts` (2 n_bins,), never-sampled ones in the
    second: the bins of Eq. 7 are the sum of both. What is counted is written to `seen`, unless that
    is empty; it may be the mask of reserved voxels itself. Both bins are looked up for each voxel:
    a processor would often guess wrong which of them is needed.
    """
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    table, distance_class, unknown_bin = gray.sampled, gray.distance_class, gray.unknown
    limits, stride, runs = view.depth.limits, view.depth.stride, view.runs
    n_gray_bins = len(counts) // 2
    step_x, step_u, step_v = step[0], step[1], step[2]
    has_classes, marks = len(table) > 1, len(seen) > 0
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        half_height, horizontal = runs.half_height[r], runs.horizontal_quarters[r]
        first = np.uint64(runs.first[r])
        for cell in range(first, first + np.uint64(runs.length[r])):
            inverse = 1.0 / X
            depth = limits[np.uint64(int(U * inverse) * stride + int(V * inverse))]
            counted = (depth >= X) & (reserved_mask[cell] == 0)
            quarters = _quarters(half_height, horizontal)
            row = np.uint64(distance_class[quarters]) if has_classes else np.uint64(0)
            of_sampled = np.uint64(table[row, np.uint64(log_odds_fixed[cell] + clamp)])
            of_unknown = np.uint64(n_gray_bins) + np.uint64(unknown_bin[quarters])
            counts[of_sampled if sampled[cell] else of_unknown] += counted
            if marks:
                seen[cell] |= counted
            X += step_x
            U += step_u
            V += step_v
            half_height += 2.0


@borrowing_kernel
def _new_information(
    counts: NDArray[np.int64], gray: GrayBins, bins: NDArray[np.int64]
) -> tuple[float, int]:
    """NI (Eqs. 6 and 7) and the number of unknown voxels, from the counts of `_count_voxels`.

    `bins` (n_bins,) is scratch; all counts are zero afterwards.
    """
    unknown = 0
    for b in range(gray.n_bins):
        unknown += counts[gray.n_bins + b]
        bins[b] = counts[b] + counts[gray.n_bins + b]
        counts[b] = counts[gray.n_bins + b] = 0
    return histogram_entropy(bins, gray), unknown


@kernel
def evaluate_views(
    viewed: ViewedMap,
    reserved_mask: NDArray[np.uint8],
    poses: PoseArrays,
    spheres: SphereArrays,
    camera: CameraArrays,
    gray: GrayBins,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """Write NI (Eqs. 6 to 8) and the number of unknown voxels in view of each pose (k,)."""
    view, nothing = allocate_view(camera), np.empty(0, np.uint8)
    counts, bins = np.zeros(2 * gray.n_bins, np.int64), np.empty(gray.n_bins, np.int64)
    for p in range(len(poses.positions)):
        pose = RigidTransform(poses.rotations[p], poses.positions[p])
        n, step = trace_view(viewed, pose, spheres, camera, view)
        _count_voxels(viewed.arrays, reserved_mask, n, step, view, gray, counts, nothing)
        ni[p], unknown[p] = _new_information(counts, gray, bins)


@kernel
def sequential_new_information(
    viewed: ViewedMap,
    reserved_mask: NDArray[np.uint8],
    poses: PoseArrays,
    spheres: SphereArrays,
    ends: NDArray[np.int64],
    camera: CameraArrays,
    gray: GrayBins,
    ni: NDArray[np.float64],
) -> None:
    """Write NI of one pose for each robot (k,), without what the robots before it see.

    The spheres that hide something from a robot end at number `ends` (k,). What a robot sees is
    reserved for it while this runs: `reserved_mask` is zero before and afterwards.
    """
    view = allocate_view(camera)
    counts, bins = np.zeros(2 * gray.n_bins, np.int64), np.empty(gray.n_bins, np.int64)
    first_seen, end_seen, first_sphere = len(reserved_mask), 0, 0
    for p in range(len(poses.positions)):
        pose = RigidTransform(poses.rotations[p], poses.positions[p])
        own = SphereArrays(
            spheres.centers[first_sphere : ends[p]], spheres.radii[first_sphere : ends[p]]
        )
        first_sphere = ends[p]
        n, step = trace_view(viewed, pose, own, camera, view)
        _count_voxels(
            viewed.arrays, reserved_mask, n, step, view, gray, counts, reserved_mask
        )  # fmt: skip
        ni[p], _ = _new_information(counts, gray, bins)
        if n:  # runs are in the order of their voxels
            first_seen = min(first_seen, view.runs.first[0])
            end_seen = max(end_seen, view.runs.first[n - 1] + view.runs.length[n - 1])
    reserved_mask[first_seen:end_seen] = 0


@unchecked_division_kernel
def _sum_weights(
    weights: NDArray[np.float32], n: int, step: NDArray[np.float64], view: ViewBuffers
) -> float:
    """Sum of the weights of the visible voxels of n runs, in the order of the voxels.

    Listed first, as `list_visible_cells` does, and then summed, views take a third longer.
    """
    limits, stride, runs = view.depth.limits, view.depth.stride, view.runs
    total = 0.0
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        for cell in range(runs.first[r], runs.first[r] + runs.length[r]):
            inverse = 1.0 / X
            is_visible = limits[int(U * inverse) * stride + int(V * inverse)] >= X
            total += float(weights[cell]) if is_visible else 0.0
            X += step[0]
            U += step[1]
            V += step[2]
    return total


@kernel
def sum_views(
    viewed: ViewedMap,
    weights: NDArray[np.float32],
    poses: PoseArrays,
    spheres: SphereArrays,
    camera: CameraArrays,
    out: NDArray[np.float64],
) -> None:
    """Write the sum of the weights (n_voxels,) of the voxels in view of each pose (k,)."""
    view = allocate_view(camera)
    for p in range(len(poses.positions)):
        pose = RigidTransform(poses.rotations[p], poses.positions[p])
        n, step = trace_view(viewed, pose, spheres, camera, view)
        out[p] = _sum_weights(weights, n, step, view)


@unchecked_division_kernel
def list_visible_cells(
    viewed: ViewedMap, pose: RigidTransform, spheres: SphereArrays, camera: CameraArrays
) -> NDArray[np.int32]:
    """Flat indices of the voxels that a pose sees, reserved ones included."""
    view = allocate_view(camera)
    limits, stride, runs = view.depth.limits, view.depth.stride, view.runs
    n, step = trace_view(viewed, pose, spheres, camera, view)
    size = 0
    for r in range(n):
        size += runs.length[r]
    cells, count = np.empty(size, np.int32), 0
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        for cell in range(runs.first[r], runs.first[r] + runs.length[r]):
            inverse = 1.0 / X
            cells[count] = cell  # the next one is written over it unless it is visible
            count += limits[int(U * inverse) * stride + int(V * inverse)] >= X
            X += step[0]
            U += step[1]
            V += step[2]
    return cells[:count]
