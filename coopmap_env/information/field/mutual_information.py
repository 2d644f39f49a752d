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

from coopmap_env.geometry.traversal import advance, begin
from coopmap_env.information.entropy import entropy
from coopmap_env.information.field.depth_buffer import add_spheres, is_outside
from coopmap_env.information.field.frustum import frustum_columns, image_forms
from coopmap_env.information.field.rating import Claimed, FieldRatingFunction, checked_poses
from coopmap_env.information.field.view_tables import Spheres
from coopmap_env.information.field.views import scratch
from coopmap_env.information.planar.mutual_information import UNREACHABLE, checked_expectation
from coopmap_env.mapping import OccupancyMap


class FieldBeamInformation:
    """Mutual information of camera poses in space.

    Parameters
    ----------
    rating : FieldRatingFunction
        Holds the camera and the grid.
    prior, known : float
        See `BeamInformation`.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `known` not in (0.5, 1].
    """

    def __init__(self, rating: FieldRatingFunction, prior: float = 0.5, known: float = 1.0) -> None:
        self._prior, self._residue = checked_expectation(prior, known)
        self._rating = rating

    def mutual_information(
        self,
        map_: OccupancyMap,
        rotations: ArrayLike,
        translations: ArrayLike,
        claimed: Claimed = None,
        bodies: Spheres | None = None,
        coarse: bool = False,
    ) -> NDArray[np.float64]:
        """Nats, shape (k,); the arguments are those of `FieldRatingFunction.new_information`.

        With `coarse`, a block counts as its eight voxels, and hides as two in a row would.
        """
        sight, known = self._rating.sight(map_, claimed, coarse)
        R, t = checked_poses(rotations, translations)
        out = np.empty(len(R))
        prior = 1.0 - (1.0 - self._prior) ** 2 if coarse else self._prior
        mutual_information(
            known, sight.grid.cells(t), R, sight.spheres(bodies), sight.optics,
            map_.range.probability, map_.range.entropy, map_.range.clamp,
            prior, entropy([self._prior, 1.0 - self._prior]), self._residue, out,
        )  # fmt: skip
        return out * (8.0 if coarse else 1.0)


@njit(cache=True, nogil=True)
def _survive(known, position, R, direction, blocked, far, probability, clamp, prior, chances):
    """Write v at every half cell of depth along a ray: 1 - p multiplied over the cells before.

    `direction` is that of the ray in the camera frame, `blocked` the distance of a body, which
    nothing passes. The voxel that holds the camera hides nothing.
    """
    levels, sampled, _, (nx, ny, nz) = known
    forward, left, up = direction[0], direction[1], direction[2]
    ux = R[0, 0] * forward + R[0, 1] * left + R[0, 2] * up
    uy = R[1, 0] * forward + R[1, 1] * left + R[1, 2] * up
    uz = R[2, 0] * forward + R[2, 1] * left + R[2, 2] * up
    cx, sx, tx, dx, end_x = begin(position[0], ux, nx, ny * nz)
    cy, sy, ty, dy, end_y = begin(position[1], uy, ny, nz)
    cz, sz, tz, dz, end_z = begin(position[2], uz, nz, 1)
    cell = cx + cy + cz
    end = min(far, end_x, end_y, end_z, blocked)
    chance, behind = 1.0, 1.0
    slot, n = 0, len(chances)
    while chance >= UNREACHABLE:
        cell, tx, ty, tz, t = advance(cell, sx, sy, sz, tx, ty, tz, dx, dy, dz)
        until = n if t >= end else min(n, math.ceil(2.0 * t * forward))
        for s in range(slot, until):
            chances[s] = chance
        slot = max(slot, until)
        if t >= end:
            break
        chance = behind
        behind *= 1.0 - (probability[levels[cell] + clamp] if sampled[cell] else prior)
    if blocked < math.inf:
        slot = min(slot, math.ceil(2.0 * blocked * forward))
    for s in range(slot, n):
        chances[s] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")  # 1 / X unasked
def _sum(known, n, step, work, stride, curves, entropy, clamp, prior_entropy, residue):
    """Sum of v times entropy over the runs of a view."""
    levels, sampled, claimed, _ = known
    _, _, runs, starts = work
    total = 0.0
    for r in range(n):
        X, U, V = starts[r, 0], starts[r, 1], starts[r, 2]
        first = runs[r, 0]
        for cell in range(first, first + runs[r, 1]):
            inverse = 1.0 / X
            pixel = int(U * inverse) * stride + int(V * inverse)
            v = curves[pixel, int(2.0 * X)]
            if v > 0.0:  # noqa: SIM102 - nested is faster
                if not claimed[cell]:
                    h = entropy[levels[cell] + clamp] if sampled[cell] else prior_entropy
                    total += v * max(h - residue, 0.0)
            X += step[0]
            U += step[1]
            V += step[2]
    return total


@njit(cache=True, nogil=True)
def _curves(known, position, R, bodies, optics, distances, probability, clamp, prior, curves):
    """Write v along the beam of every pixel; one more row and column repeat the last ones."""
    lens, directions, _ = optics
    far, w, h = lens[3], lens[4], lens[5]
    for ray in range(len(directions)):
        distances[ray] = math.inf
    add_spheres(position, R, lens, directions, bodies[0], bodies[1], distances)
    for u in range(w + 1):
        for v in range(h + 1):
            ray = min(u, w - 1) * h + min(v, h - 1)
            _survive(
                known, position, R, directions[ray], distances[ray], far,
                probability, clamp, prior, curves[u * (h + 1) + v],
            )  # fmt: skip


@njit(cache=True, nogil=True)
def mutual_information(
    known, positions, rotations, bodies, optics, probability, entropy, clamp,
    prior, prior_entropy, residue, out,
):  # fmt: skip
    """Sum of v H over the voxels of each pose's frustum."""
    lens = optics[0]
    far, w, h = lens[3], lens[4], lens[5]
    work = scratch(optics)
    curves = np.empty(((w + 1) * (h + 1), int(2.0 * far) + 2), np.float32)
    for p in range(len(positions)):
        position, R = positions[p], rotations[p]
        out[p] = 0.0
        if is_outside(known[3], position):
            continue
        _curves(known, position, R, bodies, optics, work[0], probability, clamp, prior, curves)
        forms = image_forms(R, lens)
        n = frustum_columns(known[3], position, R, forms, lens, work[2], work[3])
        out[p] = _sum(
            known, n, forms[:, 2], work, h + 1, curves, entropy, clamp, prior_entropy, residue
        )
