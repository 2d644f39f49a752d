"""A depth camera on a grid of one resolution, prepared for the kernels over views."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import are_finite
from coopmap_env.geometry import Spheres
from coopmap_env.information.field._depth_buffer import CameraArrays, SphereArrays
from coopmap_env.information.field.frustum import MAX_PIXEL_ANGLE, Frustum
from coopmap_env.information.field.view_calls import (
    evaluate_poses,
    evaluate_team,
    find_visible_cells,
    plain_camera,
    plain_map,
    sum_poses,
)
from coopmap_env.information.field.views import PoseArrays
from coopmap_env.information.gray_levels import GrayBins, GrayLevelTable
from coopmap_env.information.ratings import CameraPoses
from coopmap_env.information.settings import RatingSettings
from coopmap_env.mapping import LogOddsRange, VoxelGrid
from coopmap_env.mapping.occluders import WORD, ViewedMap
from coopmap_env.sensing import DepthCamera

NO_SPHERES = SphereArrays(np.zeros((0, 3)), np.zeros(0))


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
        arrays = CameraArrays(
            frustum.geometry,
            frustum.directions,
            frustum.max_runs(grid.shape),
            frustum.max_columns(grid.shape[1]) * grid.shape[2] + 2 * WORD,
        )
        return cls(grid, frustum, arrays, gray_levels)

    @cached_property
    def gray(self) -> GrayBins:
        """The gray levels as kernels take them."""
        return self.gray_levels.arrays(self.frustum.max_visible_cells)

    @cached_property
    def plain_camera(self) -> PlainTuple:
        """The camera for `view_calls`."""
        return plain_camera(self.camera)

    @cached_property
    def plain_gray(self) -> PlainTuple:
        """The gray levels for `view_calls`."""
        return tuple(self.gray)

    def to_cell_spheres(self, spheres: Spheres | None) -> SphereArrays:
        """Spheres in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        if spheres is None:
            return NO_SPHERES
        centers, radii = (np.asarray(part, dtype=np.float64) for part in spheres)
        if centers.shape != (*radii.shape, 3) or radii.ndim != 1:
            raise ValueError(
                "occluder_spheres are centers (s, 3) and radii (s,), "
                f"got shapes {centers.shape} and {radii.shape}"
            )
        out = SphereArrays(np.empty(centers.shape), radii / self.grid.resolution)
        if not (self._to_cells(centers, out.centers) and are_finite(out.radii)):
            raise ValueError(
                f"occluder_spheres have a value that is not finite: {centers}, {radii}"
            )
        return out

    def to_cell_poses(self, poses: CameraPoses) -> PoseArrays:
        """Camera poses in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        R = np.ascontiguousarray(poses[0], dtype=np.float64)
        t = np.asarray(poses[1], dtype=np.float64)
        if t.ndim != 2 or t.shape[1] != 3 or R.shape != (len(t), 3, 3):
            raise ValueError(
                "camera poses are rotations (k, 3, 3) and translations (k, 3), "
                f"got shapes {R.shape} and {t.shape}"
            )
        positions = np.empty(t.shape)
        if not (self._to_cells(t, positions) and are_finite(R.ravel())):
            raise ValueError("a camera pose has a value that is not finite")
        return PoseArrays(R, positions)

    def _to_cells(self, points: NDArray[np.float64], out: NDArray[np.float64]) -> bool:
        """Write `VoxelGrid.to_cell_units`; return whether all are finite."""
        lower, resolution, _ = self.grid.geometry
        return write_cell_units(np.ascontiguousarray(points), lower, resolution, out)

    def evaluate(
        self,
        viewed: ViewedMap,
        reserved_mask: NDArray[np.uint8],
        poses: CameraPoses,
        occluder_spheres: Spheres | None,
    ) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """NI and number of unknown voxels of each pose, (k,)."""
        cameras, spheres = self.to_cell_poses(poses), self.to_cell_spheres(occluder_spheres)
        ni = np.empty(len(cameras.positions))
        unknown = np.empty(len(ni), dtype=np.int64)
        evaluate_poses(
            plain_map(viewed), reserved_mask, tuple(cameras), tuple(spheres),
            self.plain_camera, self.plain_gray, ni, unknown,
        )  # fmt: skip
        return ni, unknown

    def sum_weights(
        self,
        viewed: ViewedMap,
        weights: NDArray[np.float32],
        poses: CameraPoses,
        occluder_spheres: Spheres | None,
    ) -> NDArray[np.float64]:
        """Sum of the weights of the voxels in view of each pose, (k,)."""
        cameras, spheres = self.to_cell_poses(poses), self.to_cell_spheres(occluder_spheres)
        out = np.empty(len(cameras.positions))
        sum_poses(
            plain_map(viewed), weights, tuple(cameras), tuple(spheres), self.plain_camera, out
        )
        return out

    def evaluate_team(
        self,
        viewed: ViewedMap,
        reserved_mask: NDArray[np.uint8],
        poses: CameraPoses,
        occluder_spheres: Sequence[Spheres | None] | None,
    ) -> NDArray[np.float64]:
        """NI of one pose for each robot, without what those before it see, (k,).

        Raises
        ------
        ValueError
            If poses or spheres do not fit, see `to_cell_poses` and `to_cell_spheres`, or the number
            of robots differs.
        """
        cameras = self.to_cell_poses(poses)
        ni = np.empty(len(cameras.positions))
        if occluder_spheres is None:
            occluder_spheres = [None] * len(ni)
        if len(occluder_spheres) != len(ni):
            raise ValueError(
                f"occluder_spheres needs one entry for each of {len(ni)} poses, "
                f"got {len(occluder_spheres)}"
            )
        each = [NO_SPHERES, *(self.to_cell_spheres(own) for own in occluder_spheres)]
        spheres = tuple(np.concatenate(parts) for parts in zip(*each, strict=True))
        ends = np.cumsum([len(own.radii) for own in each[1:]], dtype=np.int64)
        evaluate_team(
            plain_map(viewed), reserved_mask, tuple(cameras), spheres, ends,
            self.plain_camera, self.plain_gray, ni,
        )  # fmt: skip
        return ni

    def visible_cells(
        self,
        viewed: ViewedMap,
        pose: tuple[ArrayLike, ArrayLike],
        occluder_spheres: Spheres | None,
    ) -> NDArray[np.int32]:
        """Flat indices of the voxels in view."""
        cameras = self.to_cell_poses((np.asarray(pose[0])[None], np.asarray(pose[1])[None]))
        spheres = self.to_cell_spheres(occluder_spheres)
        return find_visible_cells(
            plain_map(viewed), tuple(cameras), tuple(spheres), self.plain_camera
        )


@kernel
def write_cell_units(
    points: NDArray[np.float64],
    lower: NDArray[np.float64],
    resolution: float,
    out: NDArray[np.float64],
) -> bool:
    """Write points (k, 3) in cells from the corner `lower`; return whether all are finite."""
    finite = True
    for p in range(len(points)):
        for axis in range(3):
            out[p, axis] = (points[p, axis] - lower[axis]) / resolution
            finite &= math.isfinite(out[p, axis])
    return finite
