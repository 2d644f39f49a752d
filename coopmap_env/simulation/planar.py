"""The planar simulator: a camera scans the true world, beam by beam."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import sin_cos_array
from coopmap_env.core.random_streams import draw_stream
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import PlanarCamera, RangeNoise, Scan
from coopmap_env.simulation.planar_scans import PlanarCameraArrays, simulate_scan
from coopmap_env.simulation.scenes.planar.world import PlanarWorld
from coopmap_env.simulation.simulator import MoveResult


def camera_arrays(camera: PlanarCamera, noise: RangeNoise) -> PlanarCameraArrays:
    """A camera and its noise for kernels."""
    sines, cosines = sin_cos_array(camera.bearings)
    beams = np.column_stack([cosines, sines])
    return PlanarCameraArrays(beams, float(camera.depth_of_field), noise.parameters)


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
        self._camera = camera_arrays(camera, noise)
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
        n = self.camera.n_beams
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
            (self._camera.beams, self._camera.reach, tuple(self._camera.noise)),
            draw_stream(rng),
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
