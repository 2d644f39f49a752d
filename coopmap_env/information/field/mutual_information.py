"""Mutual information between a voxel map and the beams of a depth camera.

The chain rule of `information.mutual_information`: the entropy of the voxels, each weighted
by the probability v that a beam gets there. One beam for each pixel of the depth buffer gives v
along its path; every voxel of the frustum takes it from the beam of its pixel, at its own depth. So
each voxel counts once, and none falls between two beams.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel, unchecked_division_kernel
from coopmap_env.geometry import RigidTransform, start_ray, step_ray
from coopmap_env.information._mutual_information import (
    MIN_REACH_PROBABILITY,
    CellModel,
    validate_prior,
)
from coopmap_env.information.field._depth_buffer import (
    CameraArrays,
    SphereArrays,
    add_spheres,
    is_outside,
)
from coopmap_env.information.field.frustum import projection_rows
from coopmap_env.information.field.frustum_runs import FrustumRuns, frustum_runs
from coopmap_env.information.field.rating import FieldRatingFunction
from coopmap_env.information.field.views import PoseArrays, allocate_view
from coopmap_env.information.ratings import WHOLE_VIEW, CameraPoses, ViewContext
from coopmap_env.mapping import MapArrays, OccupancyMap


class FieldMutualInformation:
    """Mutual information of camera poses.

    Parameters
    ----------
    rating : FieldRatingFunction
        Holds the camera and the grid.
    prior, known_probability : float
        See `PlanarMutualInformation`.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `known_probability` not in (0.5, 1].
    """

    def __init__(
        self, rating: FieldRatingFunction, prior: float = 0.5, known_probability: float = 1.0
    ) -> None:
        validate_prior(prior, known_probability)
        self._prior, self._known_probability = float(prior), known_probability
        self._rating = rating

    def mutual_information(
        self, map_: OccupancyMap, poses: CameraPoses, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.float64]:
        """Nats, shape (k,); the arguments are those of `FieldRatingFunction.new_information`.

        On the pooled map a block counts as its eight voxels, and hides as two in a row would.
        """
        coarse = context.coarse
        tables, viewed, reserved = self._rating.checked_inputs(map_, context.reserved_mask, coarse)
        cameras, spheres = (
            tables.to_cell_poses(poses),
            tables.to_cell_spheres(context.occluder_spheres),
        )
        out = np.empty(len(cameras.positions))
        model = CellModel.of_map(map_.log_odds_range, self._prior, self._known_probability)
        if coarse:
            model = model._replace(prior=1.0 - (1.0 - self._prior) ** 2)
        write_mutual_information(
            viewed.arrays, reserved, cameras, spheres, tables.camera, model, out
        )
        return out * (8.0 if coarse else 1.0)


@kernel
def _reach_probabilities_along_ray(
    arrays: MapArrays,
    pose: RigidTransform,
    direction: NDArray[np.float64],
    blocked: float,
    far: float,
    model: CellModel,
    out: NDArray[np.float32],
) -> None:
    """Write v at every half cell of depth along a ray: 1 - p multiplied over the cells before.

    `direction` is that of the ray in the camera frame, `blocked` the distance of a sphere, which
    nothing passes. The voxel that holds the camera hides nothing.
    """
    log_odds_fixed, sampled = arrays.log_odds_fixed, arrays.sampled_mask
    R, position, clamp = pose.rotation, pose.translation, arrays.clamp
    forward, left, up = direction[0], direction[1], direction[2]
    ux = R[0, 0] * forward + R[0, 1] * left + R[0, 2] * up
    uy = R[1, 0] * forward + R[1, 1] * left + R[1, 2] * up
    uz = R[2, 0] * forward + R[2, 1] * left + R[2, 2] * up
    ray, at = start_ray(position, (ux, uy, uz), arrays.shape)
    end = min(far, ray.end, blocked)
    reach_probability, behind = 1.0, 1.0
    slot, n = 0, len(out)
    while reach_probability >= MIN_REACH_PROBABILITY:
        at = step_ray(ray, at)
        until = n if at.distance >= end else min(n, math.ceil(2.0 * at.distance * forward))
        for s in range(slot, until):
            out[s] = reach_probability
        slot = max(slot, until)
        if at.distance >= end:
            break
        reach_probability = behind
        behind *= 1.0 - (
            model.occupancy[log_odds_fixed[at.cell] + clamp] if sampled[at.cell] else model.prior
        )
    if blocked < math.inf:
        slot = min(slot, math.ceil(2.0 * blocked * forward))
    for s in range(slot, n):
        out[s] = 0.0


@unchecked_division_kernel
def _weighted_entropy(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    runs: FrustumRuns,
    n: int,
    step: NDArray[np.float64],
    stride: int,
    reach_probabilities: NDArray[np.float32],
    model: CellModel,
) -> float:
    """Sum of v times entropy over the n runs of a view."""
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    total = 0.0
    for r in range(n):
        X, U, V = runs.x[r], runs.u[r], runs.v[r]
        for cell in range(runs.first[r], runs.first[r] + runs.length[r]):
            inverse = 1.0 / X
            pixel = int(U * inverse) * stride + int(V * inverse)
            v = reach_probabilities[pixel, int(2.0 * X)]
            if v > 0.0:  # noqa: SIM102 - nested is faster
                if not reserved_mask[cell]:
                    h = (
                        model.entropy[log_odds_fixed[cell] + clamp]
                        if sampled[cell]
                        else model.prior_entropy
                    )
                    total += v * max(h - model.known_entropy, 0.0)
            X += step[0]
            U += step[1]
            V += step[2]
    return total


@kernel
def _pixel_reach_probabilities(
    arrays: MapArrays,
    pose: RigidTransform,
    spheres: SphereArrays,
    camera: CameraArrays,
    model: CellModel,
    distances: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Write v along the beam of every pixel; one more row and column repeat the last ones."""
    directions = camera.directions
    far, w, h = camera.frustum.far, camera.frustum.width, camera.frustum.height
    for ray in range(len(directions)):
        distances[ray] = math.inf
    add_spheres(pose, camera.frustum, directions, spheres, distances)
    for u in range(w + 1):
        for v in range(h + 1):
            ray = min(u, w - 1) * h + min(v, h - 1)
            _reach_probabilities_along_ray(
                arrays, pose, directions[ray], distances[ray], far, model, out[u * (h + 1) + v]
            )


@kernel
def write_mutual_information(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    poses: PoseArrays,
    spheres: SphereArrays,
    camera: CameraArrays,
    model: CellModel,
    out: NDArray[np.float64],
) -> None:
    """Write the sum of v H over the voxels of each pose's frustum."""
    frustum = camera.frustum
    w, h = frustum.width, frustum.height
    view = allocate_view(camera)
    probabilities = np.empty(((w + 1) * (h + 1), int(2.0 * frustum.far) + 2), np.float32)
    for p in range(len(poses.positions)):
        pose = RigidTransform(poses.rotations[p], poses.positions[p])
        out[p] = 0.0
        if is_outside(arrays.shape, pose.translation):
            continue
        _pixel_reach_probabilities(
            arrays, pose, spheres, camera, model, view.depth.distances, probabilities
        )
        rows = projection_rows(pose.rotation, frustum)
        n = frustum_runs(arrays.shape, pose, rows, frustum, view.runs)
        out[p] = _weighted_entropy(
            arrays, reserved_mask, view.runs, n, rows[:, 2], h + 1, probabilities, model
        )
