"""Observations of a field robot, and of a centralised critic.

Observation of one robot, a `Dict`:

``map``: uint8 (2 Z, V, V), V, Z = `FieldSettings.crop_cells`. A crop of the probabilistic 3-D map
around the robot's base: cell [z, i, j] lies (i + 1/2 - V/2) cells ahead of the base,
(j + 1/2 - V/2) to its left and (z + 1/2) above the bottom of the map; a cell is
`FieldSettings.crop_pooling` voxels wide.

============  ===========  =====================================================================
channels      content      values
============  ===========  =====================================================================
0 ... Z-1     occupancy    255 P(occupied) of the most occupied sampled voxel, rounded; 128 where
                           none was sampled
Z ... 2Z-1    sampled      255 times the fraction of sampled voxels, rounded down
============  ===========  =====================================================================

``joints``: float32 (n,) in [-1, 1], encoder readings, normalized to the joint limits.

``camera``: float32 (9,) in [-1, 1], the estimated camera pose in the robot's base frame.

=======  ===============================================================
index    content
=======  ===============================================================
0 - 2    ahead, left, up from the base, in depths of field
3 - 5    direction of the optical axis
6 - 8    direction of the image's upper edge
=======  ===============================================================

``teammates``: float32 (n_robots - 1, 9) in [-1, 1], the same of each teammate's camera, in the own
base frame, positions in diagonals of the world; in order of their indices, absent for one robot;
zeros until both robots are located.

With ``initialization="search"``, ``located``: int8 (n_robots,), 1 for each located robot, the own
one first, teammates as above. Until a robot is located, ``map`` shows its own map.

``budget``: float32 (2,) in [0, 1], what is left of the episode.

=======  =====================================================================
index    content
=======  =====================================================================
0        scans of each robot, as a fraction of ``max_scans``
1        time, as a fraction of ``max_time``; 1 where time does not end it
=======  =====================================================================

In "candidates" mode also ``candidates``: float32 (m, n + 11) for n joints, zeros where masked, and
``action_mask``: int8 (m,), 1 where the candidate can be taken.

==========  =====================================================================
index       content
==========  =====================================================================
0 ... n-1   joints, as above
n ... n+5   position (at most 10) and optical axis of the camera there, as 0 - 5 of ``camera``
n+6         NI (Eqs. 6-8) as a fraction of its maximum, ln(n_gray_bins)
n+7         motion cost (Eqs. 5, 9) as a fraction of ln(n_gray_bins), at most 10
n+8         P(occupied) at the camera position
n+9         rating (Eq. 9) as a fraction of ln(n_gray_bins), at least -10
n+10        never-sampled voxels in view, as a fraction of the most it can see
==========  =====================================================================

NI, and with it the rating, and the never-sampled voxels are those of views on the map pooled to
half its resolution (`coopmap_env.mapping.pooling`), unless `FieldSettings.candidate_views` is
"exact". Rewards and `FieldBelief.rate` are exact.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.field._map_crop import Crop, CropUpdate, write_crop
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.column_changes import ColumnChanges

FEATURE_LIMIT = 10.0
N_CAMERA_VALUES = 9
BYTES_PER_CROP_COLUMN = 100
"""Memory that it takes to prepare a column of voxels of the crop."""
N_POSE_AND_RATING_FEATURES = 11
"""Features of a candidate besides its joints."""


class ShownCrop(NamedTuple):
    """The crop of the map that a robot was shown last."""

    base: Pose
    """Of the robot."""
    crop: Crop
    changes: ColumnChanges
    """Those of the map."""
    n_changes: int
    """Changes until then."""
    cells: NDArray[np.uint8]


class FieldObserver:
    """Computes observations and declares their spaces; one object per environment.

    The entry ``budget`` and the end of the state are the same in all environments: `MappingEnv`
    adds them.

    Parameters
    ----------
    grid : VoxelGrid
    settings : FieldSettings
    n_joints : sequence of int
        Of each robot's mount.
    n_candidates : int or None
        m in "candidates" mode.
    include_located : bool, optional
        Whether observations include which robots are located.
    """

    def __init__(
        self,
        grid: VoxelGrid,
        settings: FieldSettings,
        n_joints: Sequence[int],
        n_candidates: int | None,
        include_located: bool = False,
    ) -> None:
        self._include_located = include_located
        self._grid = grid
        self._settings = settings
        self._crop_size = settings.crop_cells, settings.crop_pooling
        self._n_joints = tuple(n_joints)
        self._n_candidates = n_candidates
        self._diagonal = length([n * grid.resolution for n in grid.shape])
        self._byte_of_log_odds = np.round(255 * settings.log_odds_range.probability).astype(
            np.uint8
        )
        (side, height), pooling = self._crop_size
        check_bytes(
            BYTES_PER_CROP_COLUMN * (side * pooling) ** 2 + 16 * pooling**3 + 8 * height * pooling,
            "the observed crop (crop_cells, crop_pooling)",
        )
        features = 4 * (max(self._n_joints) + N_POSE_AND_RATING_FEATURES) * (n_candidates or 0)
        check_bytes(
            len(self._n_joints) * (2 * height * side**2 + features),
            "an observation of all robots (n_robots, crop_cells, n_candidates)",
        )
        self._shown: dict[int, ShownCrop] = {}
        self._max_information = log(settings.rating.n_gray_bins)

    def space(self, robot: int) -> spaces.Dict:
        """Make a new observation space of one robot."""
        (side, height), m = self._settings.crop_cells, self._n_candidates
        n, n_others = self._n_joints[robot], len(self._n_joints) - 1
        parts: dict[str, spaces.Space[Any]] = {
            "map": spaces.Box(0, 255, (2 * height, side, side), np.uint8),
            "joints": spaces.Box(-1.0, 1.0, (n,), np.float32),
            "camera": spaces.Box(-1.0, 1.0, (N_CAMERA_VALUES,), np.float32),
        }
        if n_others:
            parts["teammates"] = spaces.Box(-1.0, 1.0, (n_others, N_CAMERA_VALUES), np.float32)
        if self._include_located:
            parts["located"] = spaces.Box(0, 1, (1 + n_others,), np.int8)
        if m is not None:
            parts["candidates"] = spaces.Box(
                -FEATURE_LIMIT, FEATURE_LIMIT, (m, n + N_POSE_AND_RATING_FEATURES), np.float32
            )
            parts["action_mask"] = spaces.Box(0, 1, (m,), np.int8)
        return spaces.Dict(parts)

    def observe(self, belief: FieldBelief) -> list[Observation]:
        """Observations of all robots, as new arrays."""
        return [self._observe(belief, robot) for robot in range(len(self._n_joints))]

    def state_space(self) -> spaces.Box:
        """Box (2 Z V V + sum of (n + 9)) float32 in [-1, 1]; see `state`.

        That of the environment has the two values of ``budget`` behind them.
        """
        side, height = self._settings.crop_cells
        size = (
            2 * height * side * side + sum(self._n_joints) + N_CAMERA_VALUES * len(self._n_joints)
        )
        return spaces.Box(-1.0, 1.0, (size,), np.float32)

    def state(self, belief: FieldBelief) -> NDArray[np.float32]:
        """The map around the target and all robots as one vector, for centralised critics.

        First the crop as in ``map``, around the origin of the target's frame, between 0 and 1; then
        the joints of each robot, then each robot's camera in the target's frame as in ``camera``,
        positions in diagonals of the world; zeros for a robot that is not located.
        """
        origin = Pose.identity()
        crop, cells = self._new_crop(origin)
        self._write_crop(belief.map, crop, -1, cells)
        robots = range(len(self._n_joints))
        joints = [belief.joint_spaces[robot].normalize(belief.joints[robot]) for robot in robots]
        cameras = [
            camera_vector(belief.estimates[robot].pose, origin, self._diagonal)
            if belief.located[robot]
            else np.zeros(N_CAMERA_VALUES, dtype=np.float32)
            for robot in robots
        ]
        return np.concatenate(
            [cells.ravel() / np.float32(255), *joints, *cameras], dtype=np.float32
        )

    def _observe(self, belief: FieldBelief, robot: int) -> Observation:
        base = belief.vehicles[robot].T_world_base
        cameras = [estimate.pose for estimate in belief.estimates]
        far = self._settings.camera.depth_of_field
        observation: Observation = {
            "map": self._map_crop(belief.planning_map(robot), robot, base),
            "joints": belief.joint_spaces[robot].normalize(belief.joints[robot]),
            "camera": camera_vector(cameras[robot], base, far),
        }
        others = [other for other in range(len(cameras)) if other != robot]
        if others:
            known = belief.located_teammates(robot)
            teammates = np.zeros((len(others), N_CAMERA_VALUES), dtype=np.float32)
            for row, other in enumerate(others):
                if other in known:
                    teammates[row] = camera_vector(cameras[other], base, self._diagonal)
            observation["teammates"] = teammates
        if self._include_located:
            located = belief.located
            observation["located"] = np.array(
                [located[robot], *(located[other] for other in others)], dtype=np.int8
            )
        if belief.candidates is not None and self._n_candidates is not None:
            candidates = belief.candidates[robot]
            features = np.zeros(
                (self._n_candidates, self._n_joints[robot] + N_POSE_AND_RATING_FEATURES),
                dtype=np.float32,
            )
            if len(candidates):
                features[: len(candidates)] = self._candidate_features(belief, robot, candidates)
            observation["candidates"] = features
            observation["action_mask"] = (np.arange(self._n_candidates) < len(candidates)).astype(
                np.int8
            )
        return observation

    def _map_crop(self, map_: OccupancyMap, robot: int, base: Pose) -> NDArray[np.uint8]:
        """The crop of a robot: what it was shown last, written again where the map has changed.

        Which voxels it shows is computed once for each base: vehicles do not drive.
        """
        changes, shown = map_.changes, self._shown.get(robot)
        if shown is None or shown.base is not base:
            (crop, cells), since = self._new_crop(base), -1
        else:
            crop, cells = shown.crop, shown.cells
            since = shown.n_changes if shown.changes is changes else -1
        self._write_crop(map_, crop, since, cells)
        self._shown[robot] = ShownCrop(base, crop, changes, changes.count, cells)
        return cells.copy()

    def _new_crop(self, base: Pose) -> tuple[Crop, NDArray[np.uint8]]:
        """The crop around a base, and memory for its cells."""
        side, height = self._settings.crop_cells
        crop = Crop.around(self._grid, base, *self._crop_size)
        return crop, np.empty((2 * height, side, side), dtype=np.uint8)

    def _write_crop(
        self, map_: OccupancyMap, crop: Crop, since: int, cells: NDArray[np.uint8]
    ) -> None:
        update = CropUpdate(map_.changes.last_change, since)
        pooling = self._settings.crop_pooling
        write_crop(map_.arrays, crop, pooling, self._byte_of_log_odds, update, cells)

    def _candidate_features(
        self, belief: FieldBelief, robot: int, candidates: NDArray[np.float64]
    ) -> NDArray[np.float32]:
        vehicle, n = belief.vehicles[robot], self._n_joints[robot]
        if self._settings.candidate_views == "coarse":
            belief = replace(belief, coarse=True)
        cameras = rotations, translations = vehicle.camera_poses(candidates)
        rated, unknown = belief.rate_with_unknown_fraction(robot, candidates, cameras=cameras)
        base = vehicle.T_world_base
        out = np.empty((len(candidates), n + N_POSE_AND_RATING_FEATURES), dtype=np.float32)
        out[:, :n] = belief.joint_spaces[robot].normalize(candidates)
        position = product(translations - base.translation, base.rotation)
        in_depths = position / self._settings.camera.depth_of_field
        out[:, n : n + 3] = np.clip(in_depths, -FEATURE_LIMIT, FEATURE_LIMIT)
        out[:, n + 3 : n + 6] = product(rotations[:, :, 0], base.rotation)
        out[:, n + 6] = rated.new_information / self._max_information
        out[:, n + 7] = np.minimum(rated.motion_cost / self._max_information, FEATURE_LIMIT)
        out[:, n + 8] = rated.occupancy
        out[:, n + 9] = np.maximum(rated.rating / self._max_information, -FEATURE_LIMIT)
        out[:, n + 10] = unknown
        return out


def camera_vector(camera: Pose, base: Pose, scale: float) -> NDArray[np.float32]:
    """Position in `scale` metres, optical axis and upper edge of a camera in a base frame."""
    out = np.empty(N_CAMERA_VALUES, dtype=np.float32)
    _write_camera_vector(tuple(camera.spatial_arrays), tuple(base.spatial_arrays), scale, out)
    return out


@kernel
def _write_camera_vector(
    plain_camera: PlainTuple, plain_base: PlainTuple, scale: float, out: NDArray[np.float32]
) -> None:
    """`camera_vector` of plain `RigidTransform`."""
    (camera, position), (base, origin) = plain_camera, plain_base
    for row in range(3):
        for i in range(3):
            value = 0.0
            for k in range(3):
                offset = (position[k] - origin[k]) / scale
                value += (offset if row == 0 else camera[k, 2 * (row - 1)]) * base[k, i]
            out[3 * row + i] = min(max(value, -1.0), 1.0)
