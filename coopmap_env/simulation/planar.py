"""The planar simulator: a camera scans the true world, beam by beam."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import sin_cos_array
from coopmap_env.core.random_streams import draw_stream
from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import PlanarCamera, RangeNoise, Scan
from coopmap_env.simulation.planar_scans import PlanarCameraArrays, simulate_scan
from coopmap_env.simulation.scenes.planar.world import PlanarWorld


def camera_arrays(camera: PlanarCamera, noise: RangeNoise) -> PlanarCameraArrays:
    """A camera and its noise for kernels."""
    sines, cosines = sin_cos_array(camera.bearings)
    beams = np.column_stack([cosines, sines])
    return PlanarCameraArrays(beams, float(camera.depth_of_field), noise.parameters)


class PlanarSimulator:
    """Scans of a true planar world from any pose; environments scan from their lattice.

    Parameters
    ----------
    world : PlanarWorld
    camera : PlanarCamera
    noise : RangeNoise
        Eq. 1.
    """

    def __init__(self, world: PlanarWorld, camera: PlanarCamera, noise: RangeNoise) -> None:
        self.world = world
        self.camera = camera
        self._grid = tuple(VoxelGrid(world.shape, world.resolution, world.origin).geometry)
        self._extent = (*world.shape, world.resolution, *world.origin)
        self._camera = camera_arrays(camera, noise)

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

    def _cell(self, x: float, y: float, heading: float) -> tuple[int, int]:
        nx, ny, resolution, x0, y0 = self._extent
        i, j = (x - x0) / resolution, (y - y0) / resolution
        if not (0 <= i < nx and 0 <= j < ny and math.isfinite(heading)):
            raise ValueError(
                f"the camera pose {[x, y, heading]} lies outside of the {nx} x {ny} cells"
            )
        return int(i), int(j)
