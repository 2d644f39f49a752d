"""Operations on field beliefs that only some baselines need."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.belief import CameraFrames
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.foresight import FieldForesight
from coopmap_env.envs.field.team_state import Joints
from coopmap_env.information import (
    FieldMutualInformation,
    FieldRatingFunction,
    Ratings,
    ReservedMask,
    adjacent_to_unknown,
    entropy,
    first_visible_point,
)

N_REFINED = 30
"""Poses that are scored at the map's own resolution after a ranking at half of it: the best ten of
300 are among them."""

N_CLUSTERS = 20
"""Clusters of frontier voxels that poses may belong to: the largest ones, which hold nearly all."""
N_TRIED = 50
"""Voxels of a cluster, from its middle, of which one must be seen by some pose."""


class FieldPlanning:
    """See `Planning`; poses are joints of the mounts."""

    unknown_prior = 0.02

    def mutual_information_fraction(
        self,
        belief: FieldBelief,
        robot: int,
        poses: Joints,
        prior: float,
        reserved_mask: ReservedMask | None,
    ) -> NDArray[np.float64]:
        """See `FieldMutualInformation`; a cell at the clamp cannot become more certain."""
        map_, rating = belief.planning_map(robot), belief.rating_function
        beams = _mutual_information(rating, prior, map_.log_odds_range.max_probability)
        cameras = belief.vehicles[robot].camera_poses(poses)
        context = belief.view_context(robot, reserved_mask)
        information = beams.mutual_information(map_, cameras, context)
        return information / (rating.max_visible_cells * entropy([prior, 1.0 - prior]))

    def nearest_frontier_mask(
        self, belief: FieldBelief, robot: int, poses: Joints, shows_unknown: NDArray[np.bool_]
    ) -> NDArray[np.bool_]:
        """Poses that see the frontier voxel nearest to the camera.

        A frontier voxel is sampled, can be seen through (P < 1/2) and is adjacent to never-sampled
        ones; only those that some of the marked poses sees count.
        """
        map_ = belief.planning_map(robot)
        (cells,) = np.nonzero(self.frontier_mask(belief, robot).ravel())
        grid = map_.grid
        centers = grid.center(np.stack(np.unravel_index(cells, grid.shape), axis=-1))
        distances = np.linalg.norm(centers - belief.estimates[robot].pose.translation, axis=1)
        cameras = belief.vehicles[robot].camera_poses(poses[shows_unknown])
        nearest_first = centers[np.argsort(distances, kind="stable")]
        _, sees_point = first_visible_point(
            map_, nearest_first, cameras, belief.rating_function.fine.frustum
        )
        mask = np.zeros(len(poses), dtype=np.bool_)
        mask[shows_unknown] = sees_point
        return mask

    def expected_unknown_fraction(
        self, belief: FieldBelief, robot: int, poses: Joints, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """`FieldBelief.unknown_fraction`: most of the space around a target is free."""
        return belief.unknown_fraction(robot, poses, reserved_mask)

    def foresight(
        self, belief: FieldBelief, unknown_occupancy: NDArray[np.float32] | None = None
    ) -> FieldForesight:
        """See `FieldForesight`; views pass unknown voxels, predicted ones too."""
        return FieldForesight.of_belief(belief, unknown_occupancy)

    def frontier_mask(self, belief: FieldBelief, robot: int) -> NDArray[np.bool_]:
        """Voxels that are sampled, can be seen through (P < 1/2) and border on the unknown."""
        map_ = belief.planning_map(robot)
        transparent = map_.sampled_mask.view(np.bool_) & (map_.log_odds_fixed < 0)
        mask: NDArray[np.bool_] = adjacent_to_unknown(map_) & transparent
        return mask.reshape(map_.grid.shape)

    def frontier_poses(
        self, belief: FieldBelief, robot: int, clusters: NDArray[np.int32]
    ) -> tuple[Joints, NDArray[np.int32]]:
        """The feasible poses that belong to a cluster; see `clusters_of_poses`."""
        poses = belief.feasible_poses(robot)
        numbers = self.clusters_of_poses(belief, robot, poses, clusters)
        return poses[numbers > 0], numbers[numbers > 0]

    def clusters_of_poses(
        self, belief: FieldBelief, robot: int, poses: Joints, clusters: NDArray[np.int32]
    ) -> NDArray[np.int32]:
        """The largest of the clusters of which the camera sees the middle.

        That is the voxel nearest to the mean, of those that any pose sees. Only the `N_CLUSTERS`
        largest clusters count.
        """
        map_, found = belief.planning_map(robot), np.zeros(len(poses), dtype=np.int32)
        frustum = belief.rating_function.fine.frustum
        cameras = belief.vehicles[robot].camera_poses(poses)
        sizes = np.bincount(clusters.ravel())[1:]
        for number in (np.argsort(-sizes, kind="stable") + 1)[:N_CLUSTERS]:
            points = map_.grid.center(np.argwhere(clusters == number))
            off_middle = np.square(points - points.mean(axis=0)).sum(axis=1)
            nearest_first = points[np.argsort(off_middle, kind="stable")[:N_TRIED]]
            _, sees_point = first_visible_point(map_, nearest_first, cameras, frustum)
            found[sees_point & (found == 0)] = number
        return found

    def occupied_mask(self, belief: FieldBelief, robot: int) -> NDArray[np.bool_]:
        """Sampled voxels with P >= 1/2."""
        map_ = belief.planning_map(robot)
        return map_.sampled & (map_.log_odds_fixed >= 0).reshape(map_.grid.shape)

    def camera_frames(self, belief: FieldBelief, robot: int, poses: Joints) -> CameraFrames:
        """The depth cameras, as far as they measure."""
        frustum = belief.rating_function.fine.frustum
        rotations, translations = belief.vehicles[robot].camera_poses(poses)
        near, far = np.array([frustum.near, frustum.far]) * belief.map.grid.resolution
        tangents = np.array(frustum.tangents)
        return CameraFrames(rotations, translations, tangents, float(near), float(far))

    def n_actions(self, belief: FieldBelief, robot: int, poses: Joints) -> NDArray[np.int64]:
        """One: a mount moves to any feasible pose."""
        return np.ones(len(poses), dtype=np.int64)

    def raster_offset(self, belief: FieldBelief, robot: int, poses: Joints) -> NDArray[np.int64]:
        """Counting through the joints, the last one fastest, in the order of `JointSpace.grid`."""
        space = belief.joint_spaces[robot]
        current = space.grid_index(belief.joints[robot])
        joints = belief.vehicles[robot].chain.as_joint_values(poses)
        return (space.grid_index(joints) - current - 1) % space.grid_steps**space.n

    def prescreen(
        self,
        belief: FieldBelief,
        poses: Joints,
        score: Callable[[Any, Joints], NDArray[np.float64]],
    ) -> Joints:
        """The best `N_REFINED` poses by their score on the pooled map.

        All poses if there are at most twice as many: pooling the map and ranking them on it would
        take as long as scoring them.
        """
        if len(poses) <= 2 * N_REFINED:
            return poses
        coarse_belief = replace(belief, coarse=True)
        return poses[np.argsort(-score(coarse_belief, poses), kind="stable")[:N_REFINED]]

    def rate_all(
        self, belief: FieldBelief, robot: int, poses: Joints, reserved_mask: ReservedMask | None
    ) -> Ratings:
        """`FieldBelief.rate`, without a memory: most views change with every scan."""
        return belief.rate(robot, poses, reserved_mask)


@lru_cache(maxsize=4)
def _mutual_information(
    rating: FieldRatingFunction, prior: float, known_probability: float
) -> FieldMutualInformation:
    return FieldMutualInformation(rating, prior, known_probability)
