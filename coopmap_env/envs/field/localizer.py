"""What a team knows of where it is, and how it comes to know more (2.2, 2.5).

A robot that has not found the target maps in a frame of its own: its base stands in the middle of
a grid as large as the world's. When it is located, all of its looks are placed anew, in the frame
of the target, and the team's map is made again from the looks of all that are located: measurements
are shared, not posteriors, so nothing is counted twice, and what is known by then of teammates is
kept out of every one of them.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.settings import FieldSettings
from coopmap_env.envs.field.starts import known_around
from coopmap_env.geometry import Pose, displacement_between
from coopmap_env.localization import (
    Correction,
    MotionCorrection,
    Registration,
    TargetModel,
    View,
    agree_on_frame,
    in_frame,
    register,
)
from coopmap_env.localization.registration.search import SearchSettings
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import CameraEstimate, without_bodies
from coopmap_env.sensing import PointCloud, Scan, place
from coopmap_env.simulation.scenes.field import FieldWorld

Joints = NDArray[np.float64]

NO_COVARIANCE = np.zeros((6, 6))
AGAIN = 2.0
"""Times the covariance with which registration has found a base: what motion correction begins
with. The looks that found it are corrected by the same pixels, which tell less a second time."""
ASKED_LATELY = 8
"""Looks at most that are searched for the target at once, the last ones: 40 ms each."""
LEAST_HITS = 50
"""Points of a look that is searched at all."""


class Look(NamedTuple):
    """One look as it was made, to be fused again when more is known."""

    robot: int
    cloud: PointCloud
    """As measured, with robots in it."""
    joints: tuple[Joints, ...]
    """What the encoders of all mounts said."""
    true_camera: Pose
    """T_world_camera, for the setting "exact" only."""
    estimate: CameraEstimate
    """In the world frame, or in the robot's own one until it is located."""


class Placed(NamedTuple):
    """A look in the frame in which its robot maps."""

    estimate: CameraEstimate
    scan: Scan
    correction: Correction | None
    """None if no fiducials were asked."""


def own_base(grid: VoxelGrid) -> Pose:
    """Where a robot puts itself before it is located: on the ground, in the middle of a grid."""
    low = np.array(grid.origin)
    middle = low + 0.5 * np.array(grid.shape) * grid.resolution
    return Pose(np.array([*middle[:2], 0.0]), np.eye(3))


def check_in_reach(world: FieldWorld, search: SearchSettings) -> None:
    """Raise ValueError if a vehicle stands where registration does not look for it."""
    low, high = world.target_triangles.min(axis=(0, 1)), world.target_triangles.max(axis=(0, 1))
    for robot, base in enumerate(world.base_poses):
        away = float(np.linalg.norm((base.translation - 0.5 * (low + high))[:2]))
        if not search.nearest <= away <= search.farthest:
            raise ValueError(
                f"robot_{robot} stands {away:.2f} m from the middle of the target, and is looked "
                f"for {search.nearest:g} to {search.farthest:g} m from it: set nearest or farthest "
                "of FieldSettings.registration.search, or take initialization='located'"
            )


class Locating:
    """Where the cameras and bases of a team are taken to be; one object for each episode.

    Parameters
    ----------
    settings : FieldSettings
    target : ndarray, shape (m, 3, 3)
        Triangles of the target in the world frame.
    true_bases : sequence of Pose
        T_world_base: for the setting "exact", and to name one of the frames that a symmetric
        target has.
    """

    def __init__(
        self,
        settings: FieldSettings,
        motion_correction: str,
        target: NDArray[np.float64],
        belief: FieldBelief,
        true_bases: Sequence[Pose],
    ) -> None:
        self._settings = settings
        self._mode = motion_correction
        self._bases = tuple(true_bases)
        self._triangles = target
        self._correction = (
            MotionCorrection(
                belief.vehicles, settings.camera, settings.noise, self._model,
                settings.correction, settings.fiducials, settings.tracking,
            )
            if motion_correction == "fiducials"
            else None
        )  # fmt: skip
        self._looks: list[Look] = []
        self.corrections: list[Correction | None] = [None] * len(belief.agents)
        """Of each robot's last look, if fiducials were asked."""
        self._last_scans: dict[int, Scan] = {}
        self.correction_times = [0.0] * len(belief.agents)
        """Seconds that these took; they differ from run to run."""
        self.registrations: list[Registration | None] = [None] * len(belief.agents)
        """The last attempt of each robot."""
        self.registration_times: list[float] = []
        """Seconds that those of the last step took."""

    @cached_property
    def _model(self) -> TargetModel:
        """The known target, made ready where it is asked for: not if poses are known anyway."""
        return _model_of(self._triangles.tobytes())

    def look(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, true_camera: Pose
    ) -> tuple[CameraEstimate, Scan]:
        """Where the camera is taken to be, and what it measured, placed by that.

        In the world frame, or in that of the robot's own map.
        """
        placed = self._place(belief, robot, cloud, true_camera)
        self.corrections[robot] = placed.correction
        if not all(belief.located):
            self._looks.append(Look(robot, cloud, belief.joints, true_camera, placed.estimate))
        return placed.estimate, placed.scan

    def search(self, belief: FieldBelief) -> FieldBelief:
        """Let each robot that is not located look for the target in all that it has seen.

        Those that find it are moved into the team's map.
        """
        self.registration_times = []
        for robot, known in enumerate(belief.located):
            if not known and self._saw_something(robot):
                begun = time.perf_counter()
                found = self._register(belief, robot)
                self.registration_times.append(time.perf_counter() - begun)
                self.registrations[robot] = found
                if found.located and found.T_target_base is not None:
                    belief = self._move_in(belief, robot, found)
        if all(belief.located):
            self._looks = []
        return belief

    def _place(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, true_camera: Pose
    ) -> Placed:
        """A look, placed by the setting, without what is known to be robots."""
        estimate, corrected = belief.estimates[robot], None
        if self._mode == "exact":
            pose = true_camera
            if not belief.located[robot]:
                own = belief.vehicles[robot].T_world_base
                pose = own @ self._bases[robot].inverse() @ true_camera
            estimate = CameraEstimate(pose, NO_COVARIANCE)
        clean = self._clean(belief, robot, cloud, estimate)
        if self._correction is not None and belief.located[robot]:
            begun = time.perf_counter()
            corrected = self._correction.correct(robot, belief.joints[robot], clean, belief.map)
            self.correction_times[robot] = time.perf_counter() - begun
            estimate = corrected.estimate
        scan = place(clean, estimate.pose, self._settings.noise, estimate.covariance)
        return Placed(estimate, scan, corrected)

    def _clean(
        self, belief: FieldBelief, robot: int, cloud: PointCloud, estimate: CameraEstimate
    ) -> PointCloud:
        return without_bodies(
            cloud, estimate.pose, *belief.known_bodies(robot), self._settings.noise,
            estimate.covariance,
        )  # fmt: skip

    def last_scan(self, robot: int) -> Scan:
        """The last look of a robot that was just located, placed in the team's frame."""
        return self._last_scans[robot]

    def why_not(self, robot: int) -> str:
        """Why a robot has not been located yet."""
        last = self.registrations[robot]
        return "too little was in view so far" if last is None else last.reason

    def _saw_something(self, robot: int) -> bool:
        """Whether the robot's last look can have told anything new of the target."""
        own = [look for look in self._looks if look.robot == robot]
        return bool(own) and int(own[-1].cloud.hit.sum()) >= LEAST_HITS

    def _register(self, belief: FieldBelief, robot: int) -> Registration:
        own = belief.vehicles[robot].T_world_base
        s, to_base = self._settings, own.inverse()
        seen = [
            look
            for look in self._looks
            if look.robot == robot and look.cloud.hit.sum() >= LEAST_HITS
        ]
        views = []
        for look in seen[-ASKED_LATELY:]:
            clean = self._clean(belief.moved(look.joints), robot, look.cloud, look.estimate)
            pose, covariance = look.estimate
            views.append(View(clean, CameraEstimate(to_base @ pose, covariance)))
        found = register(self._model, views, s.camera, s.noise, s.registration)
        if found.located and len(found.equivalents) > 1:
            found = self._in_one_frame(belief, robot, found, views)
        return self._inside(belief.map.grid, found, views)

    @staticmethod
    def _inside(grid: VoxelGrid, found: Registration, views: list[View]) -> Registration:
        """The registration, refused if it would put a camera outside of the map."""
        if found.T_target_base is None:
            return found
        cameras = [found.T_target_base.transform(v.estimate.pose.translation) for v in views]
        if grid.contains(grid.index(cameras)).all():
            return found
        reason = "what could be the target would put the camera outside of the map"
        return replace(found, located=False, T_target_base=None, covariance=None, reason=reason)

    def _in_one_frame(
        self, belief: FieldBelief, robot: int, found: Registration, views: list[View]
    ) -> Registration:
        """Of the poses that a symmetric target leaves, the one in the team's common frame.

        The first robot is right with each of them, so the frame takes the name that the truth has
        for it. The others go by what they see of the team's map besides the target.
        """
        if not any(belief.located):
            true = self._bases[robot]
            return in_frame(found, min(found.equivalents, key=lambda T: _apart(T, true)))
        return agree_on_frame(belief.map, found, views, self._model)

    def _move_in(self, belief: FieldBelief, robot: int, found: Registration) -> FieldBelief:
        """Move a robot and its looks into the team's frame; make the team's map again."""
        assert found.T_target_base is not None
        assert found.covariance is not None
        belief = belief.locate(robot, found.T_target_base, found.covariance)
        if self._correction is not None:
            doubtful = CameraEstimate(found.T_target_base, AGAIN * found.covariance)
            self._correction.place_base(robot, doubtful)
        own = [k for k, look in enumerate(self._looks) if look.robot == robot]
        # what sees the target best comes first: later looks are predicted by it
        for k in sorted(own, key=lambda k: -self._on_target(belief, self._looks[k])):
            look, then = self._looks[k], belief.moved(self._looks[k].joints)
            placed = self._place(then, robot, look.cloud, look.true_camera)
            self._looks[k] = look._replace(estimate=placed.estimate)
            if k == own[-1]:
                self.corrections[robot] = placed.correction
                self._last_scans[robot] = placed.scan
            belief.map.integrate(placed.scan)  # for the looks that follow to find fiducials in
        self._fuse_again(belief)
        return belief.with_estimate(robot, self._looks[own[-1]].estimate)

    def _on_target(self, belief: FieldBelief, look: Look) -> int:
        """Points of a look that lie about the target, by the mount's kinematics."""
        pose = belief.vehicles[look.robot].camera_pose(look.joints[look.robot])
        points = pose.transform(look.cloud.points[look.cloud.hit])
        low, high = self._model.bounds
        return int(((points > low) & (points < high)).all(axis=1).sum())

    def _fuse_again(self, belief: FieldBelief) -> None:
        """Make the team's map from the looks of all robots that are located."""
        located = belief.located
        bases = [v.T_world_base for v, known in zip(belief.vehicles, located, strict=True) if known]
        belief.map.clear()
        belief.map.mark_free(known_around(belief.map.grid, bases, self._settings.start_radius))
        for look in self._looks:
            if located[look.robot]:
                then, (pose, covariance) = belief.moved(look.joints), look.estimate
                clean = self._clean(then, look.robot, look.cloud, look.estimate)
                belief.map.integrate(place(clean, pose, self._settings.noise, covariance))


@lru_cache(maxsize=8)
def _model_of(target: bytes) -> TargetModel:
    """The model of a target's triangles: what is prepared of it serves in every world."""
    return TargetModel(np.frombuffer(target).reshape(-1, 3, 3))


def _apart(one: Pose, other: Pose) -> float:
    return float(np.linalg.norm(displacement_between(one, other)))


def begin_alone(maps: Sequence[OccupancyMap], start_radius: float) -> None:
    """Clear the maps of robots in frames of their own, but for the room where each was parked."""
    for map_ in maps:
        map_.clear()
        map_.mark_free(known_around(map_.grid, [own_base(map_.grid)], start_radius))
