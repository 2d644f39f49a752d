"""The planar simulator: a camera looks at the true world, beam by beam."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry.traversal import advance, begin
from coopmap_env.sensing import PlanarCamera, RangeNoise, Scan
from coopmap_env.simulation.scenes.world import World


@njit(cache=True, nogil=True)
def first_hit(occupied, px, py, ux, uy, reach):
    """Distance (cells) at which a ray enters the first occupied cell; inf if it meets none."""
    nx, ny = occupied.shape
    cx, sx, tx, dx, end_x = begin(px, ux, nx, ny)
    cy, sy, ty, dy, end_y = begin(py, uy, ny, 1)
    cell = cx + cy
    end = min(reach, end_x, end_y)
    flat = occupied.ravel()
    t = 0.0
    while t < end:
        if flat[cell]:
            return t
        cell, tx, ty, _, t = advance(cell, sx, sy, 0, tx, ty, math.inf, dx, dy, math.inf)
    return math.inf


@njit(cache=True, nogil=True)
def look(
    occupied, lower, resolution, pose, bearings, reach, noise, draws, points, covariances, hit
):
    """Fill a scan: cast each beam, disturb the hits (Eq. 1), turn covariances to the world (Eq. 3).

    `noise` is (S, T depth, T lateral, n); `draws` (n, 2) are standard normal numbers.
    """
    px, py = (pose[0] - lower[0]) / resolution, (pose[1] - lower[1]) / resolution
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for beam in range(len(bearings)):
        # unit direction in the camera frame, then in the world frame
        vx, vy = math.cos(bearings[beam]), math.sin(bearings[beam])
        ux, uy = c * vx - s * vy, s * vx + c * vy
        d = first_hit(occupied, px, py, ux, uy, reach / resolution) * resolution
        hit[beam] = d < math.inf
        if not hit[beam]:
            points[beam, 0] = pose[0] + reach * ux
            points[beam, 1] = pose[1] + reach * uy
            covariances[beam] = 0.0
            continue
        scale = noise[0] * d ** noise[3]
        depth, lateral = scale * noise[1], scale * noise[2]
        ex, ey = depth * draws[beam, 0], lateral * draws[beam, 1]
        points[beam, 0] = pose[0] + d * ux + c * ex - s * ey
        points[beam, 1] = pose[1] + d * uy + s * ex + c * ey
        xx, yy = depth * depth, lateral * lateral
        covariances[beam, 0, 0] = c * c * xx + s * s * yy
        covariances[beam, 0, 1] = c * s * (xx - yy)
        covariances[beam, 1, 0] = covariances[beam, 0, 1]
        covariances[beam, 1, 1] = s * s * xx + c * c * yy


class PlanarSimulator:
    """A true planar world and the camera that looks at it (a `Simulator`)."""

    def __init__(self, world: World, camera: PlanarCamera, noise: RangeNoise) -> None:
        self.world = world
        self.camera = camera
        self._lower = np.array(world.origin)
        self._bearings = camera.bearings
        self._noise = (
            float(noise.intrinsic),
            float(noise.depth),
            float(noise.lateral),
            float(noise.exponent),
        )

    def scan(self, pose: ArrayLike, rng: np.random.Generator) -> Scan:
        """Look from a planar pose (3,) [x, y, heading]: metres, radians."""
        n = len(self._bearings)
        points, covariances = np.empty((n, 2)), np.empty((n, 2, 2))
        hit = np.empty(n, dtype=np.bool_)
        pose_array: NDArray[np.float64] = np.asarray(pose, dtype=np.float64)
        look(
            self.world.occupied, self._lower, self.world.resolution, pose_array, self._bearings,
            self.camera.depth_of_field, self._noise, rng.standard_normal((n, 2)),
            points, covariances, hit,
        )  # fmt: skip
        return Scan(pose_array[:2].copy(), points, covariances, hit)
