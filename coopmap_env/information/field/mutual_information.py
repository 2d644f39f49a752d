"""Mutual information between a map in space and the beams of a depth camera.

The chain rule of `shannon`: the entropy of the voxels, each weighted by the chance v that a beam
gets there. One beam for each pixel of the depth buffer tells v along its way; every voxel of the
frustum takes it from the beam of its pixel, at its own depth. So each voxel counts once, and none
falls between two beams.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry.traversal import init_axis, step_voxel
from coopmap_env.information.entropy import entropy
from coopmap_env.information.field.depth_buffer import add_spheres, is_outside
from coopmap_env.information.field.frustum import frustum_runs, projection_rows
from coopmap_env.information.field.rating import (
    FieldRatingFunction,
    ReservedMask,
    validate_camera_poses,
)
from coopmap_env.information.field.view_tables import Spheres
from coopmap_env.information.field.views import allocate_view
from coopmap_env.information.planar.mutual_information import MIN_REACH_PROBABILITY, validate_prior
from coopmap_env.mapping import OccupancyMap


class FieldMutualInformation:
    """Mutual information of camera poses in space.

    Parameters
    ----------
    rating : FieldRatingFunction
        Holds the camera and the grid.
    prior, known_probability : float
        See `MutualInformation`.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `map_arrays` not in (0.5, 1].
    """

    def __init__(
        self, rating: FieldRatingFunction, prior: float = 0.5, known_probability: float = 1.0
    ) -> None:
        self._prior, self._known_entropy = validate_prior(prior, known_probability)
        self._rating = rating

    def mutual_information(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        reserved_mask: ReservedMask = None,
        occluder_spheres: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.float64]:
        """Nats, shape (k,); the arguments are those of `FieldRatingFunction.new_information`.

        With `coarse`, a block counts as its eight voxels, and hides as two in a row would.
        """
        view_tables, map_arrays = self._rating.view_tables(map_, reserved_mask, coarse)
        R, t = validate_camera_poses(rotations, translations)
        out = np.empty(len(R))
        prior = 1.0 - (1.0 - self._prior) ** 2 if coarse else self._prior
        mutual_information(
            map_arrays, view_tables.grid.to_cell_units(t), R, view_tables.spheres(occluder_spheres), view_tables.camera_arrays,
            map_.log_odds_range.probability, map_.log_odds_range.entropy, map_.log_odds_range.clamp,
            prior, entropy([self._prior, 1.0 - self._prior]), self._known_entropy, out,
        )  # fmt: skip
        return out * (8.0 if coarse else 1.0)


@njit(cache=True, nogil=True)
def _reach_probabilities_along_ray(
    map_arrays, position, R, direction, blocked, far, probability, clamp, prior, reach_probabilities
):
    """Write v at every half cell of depth along a ray: 1 - p multiplied over the cells before.

    `direction` is that of the ray in the camera frame, `blocked` the distance of a body, which
    nothing passes. The voxel that holds the camera hides nothing.
    """
    log_odds_fixed, sampled, _, (nx, ny, nz) = map_arrays
    forward, left, up = direction[0], direction[1], direction[2]
    ux = R[0, 0] * forward + R[0, 1] * left + R[0, 2] * up
    uy = R[1, 0] * forward + R[1, 1] * left + R[1, 2] * up
    uz = R[2, 0] * forward + R[2, 1] * left + R[2, 2] * up
    cx, sx, tx, dx, end_x = init_axis(position[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = init_axis(position[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = init_axis(position[2], uz, nz, 1)
    cell = cx + cy + cz
    end = min(far, end_x, end_y, end_z, blocked)
    reach_probability, behind = 1.0, 1.0
    slot, n = 0, len(reach_probabilities)
    while reach_probability >= MIN_REACH_PROBABILITY:
        cell, tx, ty, tz, t = step_voxel(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        until = n if t >= end else min(n, math.ceil(2.0 * t * forward))
        for s in range(slot, until):
            reach_probabilities[s] = reach_probability
        slot = max(slot, until)
        if t >= end:
            break
        reach_probability = behind
        behind *= 1.0 - (probability[log_odds_fixed[cell] + clamp] if sampled[cell] else prior)
    if blocked < math.inf:
        slot = min(slot, math.ceil(2.0 * blocked * forward))
    for s in range(slot, n):
        reach_probabilities[s] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # 1 / X unasked
def _weighted_entropy(
    map_arrays,
    n,
    step,
    work,
    stride,
    reach_probabilities,
    entropy,
    clamp,
    prior_entropy,
    known_entropy,
):
    """Sum of v times entropy over the runs of a view."""
    log_odds_fixed, sampled, reserved_mask, _ = map_arrays
    _, _, runs, starts = work
    total = 0.0
    for r in range(n):
        X, U, V = starts[r, 0], starts[r, 1], starts[r, 2]
        first = runs[r, 0]
        for cell in range(first, first + runs[r, 1]):
            inverse = 1.0 / X
            pixel = int(U * inverse) * stride + int(V * inverse)
            v = reach_probabilities[pixel, int(2.0 * X)]
            if v > 0.0:  # noqa: SIM102 - nested is faster
                if not reserved_mask[cell]:
                    h = entropy[log_odds_fixed[cell] + clamp] if sampled[cell] else prior_entropy
                    total += v * max(h - known_entropy, 0.0)
            X += step[0]
            U += step[1]
            V += step[2]
    return total


@njit(cache=True, nogil=True)
def _pixel_reach_probabilities(
    map_arrays,
    position,
    R,
    occluder_spheres,
    camera_arrays,
    distances,
    probability,
    clamp,
    prior,
    reach_probabilities,
):
    """Write v along the beam of every pixel; one more row and column repeat the last ones."""
    projection, directions, _ = camera_arrays
    far, w, h = projection[3], projection[4], projection[5]
    for ray in range(len(directions)):
        distances[ray] = math.inf
    add_spheres(
        position, R, projection, directions, occluder_spheres[0], occluder_spheres[1], distances
    )
    for u in range(w + 1):
        for v in range(h + 1):
            ray = min(u, w - 1) * h + min(v, h - 1)
            _reach_probabilities_along_ray(
                map_arrays, position, R, directions[ray], distances[ray], far,
                probability, clamp, prior, reach_probabilities[u * (h + 1) + v],
            )  # fmt: skip


@njit(cache=True, nogil=True)
def mutual_information(
    map_arrays, positions, rotations, occluder_spheres, camera_arrays, probability, entropy, clamp,
    prior, prior_entropy, known_entropy, out,
):  # fmt: skip
    """Sum of v H over the voxels of each pose's frustum."""
    projection = camera_arrays[0]
    far, w, h = projection[3], projection[4], projection[5]
    work = allocate_view(camera_arrays)
    reach_probabilities = np.empty(((w + 1) * (h + 1), int(2.0 * far) + 2), np.float32)
    for p in range(len(positions)):
        position, R = positions[p], rotations[p]
        out[p] = 0.0
        if is_outside(map_arrays[3], position):
            continue
        _pixel_reach_probabilities(
            map_arrays,
            position,
            R,
            occluder_spheres,
            camera_arrays,
            work[0],
            probability,
            clamp,
            prior,
            reach_probabilities,
        )
        forms = projection_rows(R, projection)
        n = frustum_runs(map_arrays[3], position, R, forms, projection, work[2], work[3])
        out[p] = _weighted_entropy(
            map_arrays,
            n,
            forms[:, 2],
            work,
            h + 1,
            reach_probabilities,
            entropy,
            clamp,
            prior_entropy,
            known_entropy,
        )
