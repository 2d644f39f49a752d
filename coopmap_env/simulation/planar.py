"""The planar simulator: a camera scans the true world, beam by beam."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power, sin_cos, sin_cos_array
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import PlanarCamera, RangeNoise, Scan
from coopmap_env.simulation.scenes.planar.world import PlanarWorld
from coopmap_env.simulation.simulator import MoveResult


@kernel
def cast_ray(
    occupied: NDArray[np.bool_], px: float, py: float, ux: float, uy: float, reach: float
) -> float:
    """Distance (cells) at which a ray enters the first occupied cell; inf if there is none."""
    nx, ny = occupied.shape
    ray, position = start_ray((px, py, 0.5), (ux, uy, 0.0), (nx, ny, 1))
    end = min(reach, ray.end)
    flat = occupied.ravel()
    while position.distance < end:
        if flat[position.cell]:
            return position.distance
        position = step_ray(ray, position)
    return math.inf


@kernel
def simulate_scan(
    occupied: NDArray[np.bool_],
    grid: PlainTuple,
    pose: NDArray[np.float64],
    beams: NDArray[np.float64],
    reach: float,
    noise: PlainTuple,
    draws: NDArray[np.float64],
    scan: PlainTuple,
) -> None:
    """Fill a scan: cast each beam, add noise to the hits (Eq. 1), rotate covariances (Eq. 3).

    `beams` (n, 2) are unit directions in the camera frame, `reach` is their length in metres;
    `draws` (n, 2) are standard normal numbers; `grid`, `noise` and `scan` are a plain
    `GridGeometry`, `NoiseParameters` and `ScanArrays`.
    """
    lower, resolution, _ = grid
    _, points, covariances, hit = scan
    px, py = (pose[0] - lower[0]) / resolution, (pose[1] - lower[1]) / resolution
    s, c = sin_cos(pose[2])
    intrinsic, depth_factor, lateral_factor, exponent = noise
    for beam in range(len(beams)):
        ux = c * beams[beam, 0] - s * beams[beam, 1]
        uy = s * beams[beam, 0] + c * beams[beam, 1]
        d = cast_ray(occupied, px, py, ux, uy, reach / resolution) * resolution
        hit[beam] = d < math.inf
        if not hit[beam]:
            points[beam, 0] = pose[0] + reach * ux
            points[beam, 1] = pose[1] + reach * uy
            covariances[beam, 0, 0] = 0.0
            covariances[beam, 0, 1] = 0.0
            covariances[beam, 1, 0] = 0.0
            covariances[beam, 1, 1] = 0.0
            continue
        scale = intrinsic * power(d, exponent)
        depth, lateral = scale * depth_factor, scale * lateral_factor
        ex, ey = depth * draws[beam, 0], lateral * draws[beam, 1]
        points[beam, 0] = pose[0] + d * ux + c * ex - s * ey
        points[beam, 1] = pose[1] + d * uy + s * ex + c * ey
        # the camera states Eq. 1 at the distance that it measured, not at the true one
        mx, my = points[beam, 0] - pose[0], points[beam, 1] - pose[1]
        scale = intrinsic * power(math.sqrt(mx * mx + my * my), exponent)
        xx, yy = (scale * depth_factor) ** 2, (scale * lateral_factor) ** 2
        covariances[beam, 0, 0] = c * c * xx + s * s * yy
        covariances[beam, 0, 1] = c * s * (xx - yy)
        covariances[beam, 1, 0] = covariances[beam, 0, 1]
        covariances[beam, 1, 1] = s * s * xx + c * c * yy


class PlanarSimulator:
    """A true planar world and the cameras that scan it (a `Simulator`).

    Parameters
    ----------
    world : PlanarWorld
    camera : PlanarCamera
        That of every robot.
    noise : RangeNoise
        Eq. 1.
    """

    def __init__(self, world: PlanarWorld, camera: PlanarCamera, noise: RangeNoise) -> None:
        self.world = world
        self.camera = camera
        self._grid = tuple(VoxelGrid(world.shape, world.resolution, world.origin).geometry)
        self._extent = (*world.shape, world.resolution, *world.origin)
        sines, cosines = sin_cos_array(camera.bearings)
        self._beams = np.column_stack([cosines, sines])
        self._noise = tuple(noise.parameters)
        self._poses: list[Sequence[float]] = []

    def set_poses(self, poses: Sequence[Sequence[float]]) -> None:
        """Set the robots to planar poses (x, y, heading): metres, radians."""
        self._poses = list(poses)

    def move(
        self, targets: Sequence[Sequence[float] | None], rng: np.random.Generator
    ) -> list[MoveResult]:
        """Move every camera to its target pose; where the cell is occupied it does not move."""
        results = []
        for robot, target in enumerate(targets):
            collides = target is not None and self.collides(target)
            if target is not None and not collides:
                self._poses[robot] = target
            results.append(MoveResult(self._poses[robot], "an occupied cell" if collides else ""))
        return results

    def scan(self, robot: int, rng: np.random.Generator) -> Scan:
        """Scan with a robot's camera from its current pose."""
        return self.scan_from(self._poses[robot], rng)

    def scan_from(self, pose: ArrayLike, rng: np.random.Generator) -> Scan:
        """Scan from a planar pose (3,) [x, y, heading]: metres, radians.

        Raises
        ------
        ValueError
            If the pose is not finite, or lies outside the world.
        """
        n = len(self._beams)
        camera_pose: NDArray[np.float64] = np.array(pose, dtype=np.float64)
        arrays = (
            camera_pose[:2],
            np.empty((n, 2)),
            np.empty((n, 2, 2)),
            np.empty(n, dtype=np.bool_),
        )
        self._cell(*camera_pose.tolist())
        simulate_scan(
            self.world.occupied,
            self._grid,
            camera_pose,
            self._beams,
            self.camera.depth_of_field,
            self._noise,
            rng.standard_normal((n, 2)),
            arrays,
        )
        return Scan(*arrays)

    def collides(self, pose: Sequence[float]) -> bool:
        """Whether the cell of a planar pose (3,) is truly occupied.

        Raises
        ------
        ValueError
            As in `scan_from`.
        """
        x, y, heading = pose
        return bool(self.world.occupied[self._cell(x, y, heading)])

    def _cell(self, x: float, y: float, heading: float) -> tuple[int, int]:
        nx, ny, resolution, x0, y0 = self._extent
        i, j = (x - x0) / resolution, (y - y0) / resolution
        if not (0 <= i < nx and 0 <= j < ny and math.isfinite(heading)):
            raise ValueError(
                f"the camera pose {[x, y, heading]} lies outside of the {nx} x {ny} cells"
            )
        return int(i), int(j)
