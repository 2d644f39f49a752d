"""A depth camera on a grid of one resolution, prepared for the kernels over views."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.limits import check_bytes
from coopmap_env.geometry import RigidTransform, Spheres
from coopmap_env.information.field._depth_buffer import CameraArrays, SphereArrays
from coopmap_env.information.field.frustum import MAX_PIXEL_ANGLE, Frustum
from coopmap_env.information.field.views import (
    PoseArrays,
    find_visible_voxels,
    write_entropies,
    write_histograms,
)
from coopmap_env.information.gray_levels import GrayBins, GrayLevelTable
from coopmap_env.information.ratings import CameraPoses
from coopmap_env.information.settings import RatingSettings
from coopmap_env.mapping import LogOddsRange, MapArrays, VoxelGrid
from coopmap_env.sensing import DepthCamera


@dataclass(frozen=True, eq=False)
class ViewTables:
    """A camera on the cells of one grid."""

    grid: VoxelGrid
    frustum: Frustum
    camera: CameraArrays
    gray_levels: GrayLevelTable
    """By the squared distance from the camera, in quarters of a squared cell, rounded down."""

    @classmethod
    def from_camera(
        cls,
        camera: DepthCamera,
        grid: VoxelGrid,
        constants: RatingSettings,
        log_odds_range: LogOddsRange,
        distance_unit: float,
    ) -> ViewTables:
        """Prepare the tables; `distance_unit` metres are the unit of the distances in Eq. 8.

        Raises
        ------
        ValueError
            If they take more memory than `coopmap_env.core.limits` allows.
        """
        unit = grid.resolution / distance_unit
        frustum = Frustum.from_camera(camera, grid.resolution, MAX_PIXEL_ANGLE * unit)
        w, h = frustum.pixels
        check_bytes(
            8 * frustum.max_visible_cells
            + 56 * frustum.max_runs(grid.shape)
            + 8 * w * h * math.ceil(frustum.far),
            "the view of a DepthCamera in voxels (far / resolution)",
        )
        quarters = np.arange(int(4 * frustum.far**2) + 2)
        gray_levels = GrayLevelTable.from_distances(
            np.sqrt(quarters) / 2 * unit,
            frustum.far * unit,
            constants,
            log_odds_range,
        )
        arrays = CameraArrays(frustum.geometry, frustum.directions, frustum.max_runs(grid.shape))
        return cls(grid, frustum, arrays, gray_levels)

    @cached_property
    def gray(self) -> GrayBins:
        """The gray levels as kernels take them."""
        return self.gray_levels.arrays(self.frustum.max_visible_cells)

    def to_cell_spheres(self, spheres: Spheres | None) -> SphereArrays:
        """Spheres in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        if spheres is None:
            return SphereArrays(np.zeros((0, 3)), np.zeros(0))
        centers, radii = (np.asarray(part, dtype=np.float64) for part in spheres)
        if centers.shape != (*radii.shape, 3) or radii.ndim != 1:
            raise ValueError(
                "occluder_spheres are centers (s, 3) and radii (s,), "
                f"got shapes {centers.shape} and {radii.shape}"
            )
        if not (np.isfinite(centers).all() and np.isfinite(radii).all()):
            raise ValueError(
                f"occluder_spheres have a value that is not finite: {centers}, {radii}"
            )
        return SphereArrays(self.grid.to_cell_units(centers), radii / self.grid.resolution)

    def to_cell_poses(self, poses: CameraPoses) -> PoseArrays:
        """Camera poses in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        R = np.ascontiguousarray(poses[0], dtype=np.float64)
        t = np.ascontiguousarray(poses[1], dtype=np.float64)
        if t.ndim != 2 or t.shape[1] != 3 or R.shape != (len(t), 3, 3):
            raise ValueError(
                "camera poses are rotations (k, 3, 3) and translations (k, 3), "
                f"got shapes {R.shape} and {t.shape}"
            )
        if not (np.isfinite(R).all() and np.isfinite(t).all()):
            raise ValueError("a camera pose has a value that is not finite")
        return PoseArrays(R, self.grid.to_cell_units(t))

    def histograms(
        self,
        arrays: MapArrays,
        reserved_mask: NDArray[np.uint8],
        poses: CameraPoses,
        occluder_spheres: Spheres | None,
    ) -> NDArray[np.int64]:
        """Gray levels in view of each pose, (k, 2 n_gray_bins): sampled voxels, then unknown."""
        cameras = self.to_cell_poses(poses)
        out = np.empty((len(cameras.positions), 2 * self.gray.n_bins), dtype=np.int64)
        spheres = self.to_cell_spheres(occluder_spheres)
        write_histograms(arrays, reserved_mask, cameras, spheres, self.camera, self.gray, out)
        return out

    def visible_voxels(
        self,
        arrays: MapArrays,
        pose: tuple[ArrayLike, ArrayLike],
        occluder_spheres: Spheres | None,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Flat indices of the voxels in view, and their squared distances in quarters."""
        (R,), (position,) = self.to_cell_poses(
            (np.asarray(pose[0])[None], np.asarray(pose[1])[None])
        )
        spheres = self.to_cell_spheres(occluder_spheres)
        return find_visible_voxels(arrays, RigidTransform(R, position), spheres, self.camera)

    def entropies(self, histogram: NDArray[np.int64]) -> NDArray[np.float64]:
        """NI (Eqs. 6, 7) of each row of `histograms`, nats, shape (k,)."""
        out = np.empty(len(histogram))
        write_entropies(histogram, self.gray, out)
        return out
