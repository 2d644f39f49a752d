"""The field simulator: vehicles on their suspensions move mounts and scan, in a true world.

What a robot measures differs from the truth in two ways. Encoders read

    reading = joint + offset + noise

with an offset for each joint that lasts for the episode, and noise that is new with each motion;
and they do not measure the body's deflections. A target is a reading: the mount moves until its
encoders read the target, unless it reaches a joint's limit or touches something before.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_choice
from coopmap_env.core.caches import freeze
from coopmap_env.core.kernels import PlainTuple
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose, RigidTransform
from coopmap_env.robots import Chain, Mount, mounted_frame_poses
from coopmap_env.sensing import DepthCamera, PointCloud, RangeNoise
from coopmap_env.simulation.depth import (
    CameraRays,
    DepthRenderer,
    TracedMesh,
    simulate_point_cloud,
)
from coopmap_env.simulation.physics import (
    BulletWorld,
    SteppingSettings,
    move_kinematically,
    move_stepped,
)
from coopmap_env.simulation.scenes.field import FieldWorld
from coopmap_env.simulation.shown_cells import mark_depth_image
from coopmap_env.simulation.simulator import MoveResult

Physics = Literal["kinematic", "stepped"]


class FieldSimulator:
    """A true field world, the vehicles in it and their cameras (a `Simulator`).

    Parameters
    ----------
    world : FieldWorld
    mounts : sequence of Mount
        One for each base pose of the world; each begins where its encoders read its home.
    camera : DepthCamera
    noise : RangeNoise
        Eq. 1.
    physics : "kinematic" or "stepped"
        How motions are computed; see `physics.kinematic` and `physics.stepped`.
    rng : numpy.random.Generator
        Draws the encoder offsets of this episode.
    stepping : SteppingSettings, optional
        For stepped physics.

    Raises
    ------
    ImportError
        If the extra "field" is not installed.
    ValueError
        If there is not one mount for each base pose, or no such physics.
    RuntimeError
        From `move`, once it is closed.
    """

    def __init__(
        self,
        world: FieldWorld,
        mounts: Sequence[Mount],
        camera: DepthCamera,
        noise: RangeNoise,
        physics: Physics,
        rng: np.random.Generator,
        stepping: SteppingSettings | None = None,
    ) -> None:
        check_choice("physics", physics, get_args(Physics))
        if len(mounts) != world.n_robots:
            raise ValueError(
                f"{len(mounts)} mounts for {world.n_robots} base poses of {world.name!r}"
            )
        self.world = world
        self.mounts = tuple(mounts)
        self.camera = camera
        self.noise = noise
        self.physics = physics
        self.stepping = stepping or SteppingSettings()
        self._chains = [mount.chain(mount.suspension is not None) for mount in mounts]
        self._believed_chains = [mount.chain() for mount in mounts]
        self._encoder_offsets = [
            np.array(mount.calibration_error) * rng.standard_normal(len(mount.joints))
            for mount in mounts
        ]
        self._encoder_errors = [offset.copy() for offset in self._encoder_offsets]
        self._encoder_noise = [np.array(mount.encoder_noise) for mount in mounts]
        self._bullet = BulletWorld(world.solids, mounts, world.base_poses, self.stepping.time_step)
        self._renderer, hidden = _renderer(world, self._chains)
        self._visible_bodies = [self._renderer.visible_bodies(bodies) for bodies in hidden]
        self._shown: NDArray[np.uint8] | None = None
        self._newly_shown = [0] * len(mounts)
        self._camera_rays = CameraRays.from_directions(camera.directions)
        self._frames = [
            _rendered_frames(chain, base)
            for chain, base in zip(self._chains, world.base_poses, strict=True)
        ]
        n_bodies = len(self._renderer.bodies)
        self._body_poses = RigidTransform(np.empty((n_bodies, 3, 3)), np.empty((n_bodies, 3)))
        for robot, mount in enumerate(mounts):
            joints = self._clip_to_limits(
                robot, np.array(mount.home) - self._encoder_offsets[robot]
            )
            self._bullet.set_configuration(
                robot, self._bullet.rest_configurations(robot, joints[None])[0]
            )
        self._update_poses()

    def move(
        self, targets: Sequence[NDArray[np.float64] | None], rng: np.random.Generator
    ) -> list[MoveResult]:
        """Move every mount until its encoders read its target (n,); `None` lets it stay.

        Kinematic physics moves the vehicles in the order of their numbers, stepped physics all at
        once. A mount that touches something stops just before, where it is free.

        Raises
        ------
        ValueError
            If there is not one target for each mount, or one is outside of the joint limits.
        RuntimeError
            If the simulator is closed.
        """
        if len(targets) != len(self.mounts):
            raise ValueError(f"{len(targets)} targets for {len(self.mounts)} mounts")
        draws = [rng.standard_normal(len(offset)) for offset in self._encoder_offsets]
        for robot, target in enumerate(targets):
            if target is not None:  # the reading of a mount that stays is the same
                noise = self._encoder_noise[robot] * draws[robot]
                self._encoder_errors[robot] = self._encoder_offsets[robot] + noise
        goals = [self._true_goal(robot, target) for robot, target in enumerate(targets)]
        collisions = self._execute(goals)
        self._update_poses()
        return [
            MoveResult(self.true_joints(robot) + error, obstacle)
            for robot, (error, obstacle) in enumerate(
                zip(self._encoder_errors, collisions, strict=True)
            )
        ]

    def scan(self, robot: int, rng: np.random.Generator) -> PointCloud:
        """What a robot's camera measures of the world and of all vehicles, in its own frame."""
        pose = self._cameras[robot]
        distances = self._renderer.trace(
            self._camera_rays, pose.arrays, self._body_poses, self._visible_bodies[robot]
        )
        if self._shown is not None:
            self._newly_shown[robot] = mark_depth_image(
                tuple(self.world.grid.geometry),
                tuple(pose.arrays),
                self.camera.directions,
                distances,
                float(self.camera.near),
                float(self.camera.far),
                self._shown,
            )
        return simulate_point_cloud(distances, self.camera, self.noise, rng)

    def views_from(
        self, robot: int, joints: NDArray[np.float64]
    ) -> Iterator[tuple[Pose, NDArray[np.float64]]]:
        """Camera poses and distances along its rays (n,), if a mount had other true joints (k, n).

        Nothing moves, and nothing has noise. The vehicle is at rest on its suspension. In view are
        the world, the vehicle itself, and of other vehicles what does not move.
        """
        bodies = [len(self._frames[k][1]) - 1 for k in range(len(self.mounts))]
        begin = sum(bodies[:robot])
        end = begin + bodies[robot]
        visible = np.zeros_like(self._visible_bodies[robot])
        visible[begin:end] = self._visible_bodies[robot][begin:end]
        poses = RigidTransform(*(part.copy() for part in self._body_poses))
        for q in self._bullet.rest_configurations(robot, joints):
            (R,), (t,) = mounted_frame_poses(self._frames[robot], q[None])
            poses.rotation[begin:end], poses.translation[begin:end] = R[:-1], t[:-1]
            camera = Pose(t[-1], R[-1])
            yield camera, self._renderer.trace(self._camera_rays, camera.arrays, poses, visible)

    def keep_shown(self, known: NDArray[np.int64]) -> None:
        """Keep which voxels scans show from now on, beside those (k,) that are known, by index."""
        self._shown = np.zeros(self.world.grid.n_cells, dtype=np.uint8)
        self._shown[known] = 1

    @property
    def shown_mask(self) -> NDArray[np.bool_]:
        """The voxels (n_voxels,) that scans have shown or that were known, since `keep_shown`.

        Raises
        ------
        RuntimeError
            If that was not called.
        """
        if self._shown is None:
            raise RuntimeError("what scans show is not kept: call keep_shown first")
        return self._shown.astype(np.bool_)

    @property
    def newly_shown(self) -> list[int]:
        """Voxels that the last scan of each robot showed first; 0 where that is not kept."""
        return list(self._newly_shown)

    def true_camera_pose(self, robot: int) -> Pose:
        """True T_world_camera: for scores, and for robots that are given their pose."""
        return self._cameras[robot]

    def true_joints(self, robot: int) -> NDArray[np.float64]:
        """True joints (n,) of a mount."""
        return self._bullet.q[robot][-len(self.mounts[robot].joints) :]

    def deflections(self, robot: int) -> NDArray[np.float64]:
        """Heave, roll and pitch of a vehicle's body: metres, radians; empty if it has none."""
        return self._bullet.q[robot][: -len(self.mounts[robot].joints)]

    def close(self) -> None:
        """Release the physics; doing so twice does no harm."""
        self._bullet.close()

    def _true_goal(
        self, robot: int, target: NDArray[np.float64] | None
    ) -> NDArray[np.float64] | None:
        """Joints (n,) at which the encoders of a mount read its target."""
        if target is None:
            return None
        reading = self._believed_chains[robot].check_limits(target)
        return self._clip_to_limits(robot, reading - self._encoder_errors[robot])

    def _clip_to_limits(self, robot: int, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        chain = self._believed_chains[robot]
        return np.minimum(np.maximum(joints, chain.lower), chain.upper)

    def _execute(self, goals: Sequence[NDArray[np.float64] | None]) -> list[str]:
        """Move to true joints; what each mount touched."""
        if self.physics == "stepped":
            goals_or_current = [
                self.true_joints(robot) if g is None else g for robot, g in enumerate(goals)
            ]
            return move_stepped(self._bullet, goals_or_current, self.stepping)
        return [
            "" if goal is None else move_kinematically(self._bullet, robot, goal)
            for robot, goal in enumerate(goals)
        ]

    def _update_poses(self) -> None:
        """Compute the poses of all cameras and rigid bodies."""
        self._cameras: list[Pose] = []
        n = 0
        for frames, q in zip(self._frames, self._bullet.q, strict=True):
            (R,), (t,) = mounted_frame_poses(frames, q[None])
            end = n + len(t) - 1
            self._body_poses.rotation[n:end], self._body_poses.translation[n:end] = R[:-1], t[:-1]
            self._cameras.append(Pose(t[-1], R[-1]))
            n = end


def _rendered_frames(chain: Chain, base: Pose) -> PlainTuple:
    """A plain `MountedFrames` of the bodies of `_vehicle_meshes`, and of the camera after them."""
    bodies = _vehicle_meshes(chain).bodies
    camera_body, rotation, translation = chain.camera_frame
    return chain.mounted(
        base,
        np.concatenate([bodies, camera_body]),
        np.concatenate([np.broadcast_to(np.eye(3), (len(bodies), 3, 3)), rotation]),
        np.concatenate([np.zeros((len(bodies), 3)), translation]),
    )


class VehicleMeshes(NamedTuple):
    """The visual surface of a vehicle, by rigid bodies."""

    bodies: NDArray[np.int64]
    """Shape (b,): rigid bodies that move and have a surface."""
    meshes: list[TracedMesh]
    """Mesh of each, in its own frame."""
    static_triangles: NDArray[np.float64]
    """Shape (m, 3, 3): of what does not move, such as wheels, base frame."""


def _renderer(
    world: FieldWorld, chains: Sequence[Chain]
) -> tuple[DepthRenderer, list[tuple[int, ...]]]:
    """A renderer of the world with all moving bodies; which of them each camera is inside of."""
    static = [
        base.transform(_vehicle_meshes(chain).static_triangles)
        for chain, base in zip(chains, world.base_poses, strict=True)
    ]
    renderer = DepthRenderer(np.concatenate([world.triangles, *static]))
    hidden: list[tuple[int, ...]] = []
    for chain in chains:
        vehicle = _vehicle_meshes(chain)
        camera_body, position = chain.link_body[chain.camera_link], _camera_position(chain)
        housing = -1
        for body, mesh in zip(vehicle.bodies.tolist(), vehicle.meshes, strict=True):
            number = renderer.add_body(mesh)
            if body == camera_body and _bounds_contain(mesh, position):
                housing = number
        hidden.append((housing,) if housing >= 0 else ())
    return renderer, hidden


@lru_cache(maxsize=16)
def _vehicle_meshes(chain: Chain) -> VehicleMeshes:
    of_body: dict[int, list[NDArray[np.float64]]] = {0: [np.zeros((0, 3, 3))]}
    for link, triangles in enumerate(chain.meshes):
        if len(triangles):
            R, t = chain.link_rotations[link], chain.link_translations[link]
            of_body.setdefault(int(chain.link_body[link]), []).append(product(triangles, R.T) + t)
    static_triangles = np.concatenate(of_body.pop(0))
    bodies = np.array(sorted(of_body), dtype=np.int64)
    meshes = [TracedMesh(np.concatenate(of_body[b])) for b in bodies.tolist()]
    return freeze(VehicleMeshes(bodies, meshes, static_triangles))


def _camera_position(chain: Chain) -> NDArray[np.float64]:
    """Position (3,) of the camera in the frame of its rigid body."""
    link = chain.camera_link
    R, t = chain.link_rotations[link], chain.link_translations[link]
    return t + product(R, chain.T_link_camera.translation)


def _bounds_contain(mesh: TracedMesh, point: NDArray[np.float64]) -> bool:
    """Whether the box around a mesh contains a point: a camera there would see nothing else."""
    return bool((np.abs(point - mesh.center) <= mesh.half_size).all())
