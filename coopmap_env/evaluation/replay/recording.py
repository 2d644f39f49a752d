"""Episodes recorded frame by frame: `record_replay` for both environments, and the field's frames.

Those of the planar environment are in `planar_recording`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.field import FieldEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.replay.planar_recording import PlanarReplay, record_planar_replay
from coopmap_env.evaluation.rollout import rollout
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera


@dataclass(frozen=True, eq=False)
class Frame:
    """What a team knew after a scan of each robot, and what happened before it.

    Attributes
    ----------
    joints : tuple of (n,) float arrays
        Measured joint positions of each robot's mount, radians or metres.
    camera_poses : tuple of Pose
        Estimated T_world_camera of each robot.
    occupied : (k,) int array
        Flat indices of the sampled voxels with P >= 1/2, ascending.
    observed_fraction : float
        Fraction of the world's voxels that were ever sampled.
    rewards : tuple of float
        Reward of each robot for this step.
    notes : tuple of str
        Why a robot stayed, or what it collided with; empty if neither.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    joints: tuple[NDArray[np.float64], ...]
    camera_poses: tuple[Pose, ...]
    occupied: NDArray[np.int64]
    observed_fraction: float
    rewards: tuple[float, ...]
    notes: tuple[str, ...]

    def __post_init__(self) -> None:
        counts = [len(part) for part in (self.joints, self.camera_poses, self.rewards, self.notes)]
        if len(set(counts)) != 1:
            raise ValueError(
                f"joints, camera_poses, rewards and notes are needed for each robot, got {counts}"
            )
        if not 0 <= self.observed_fraction <= 1:
            raise ValueError(
                "Frame.observed_fraction must be a fraction between 0 and 1, "
                f"got {self.observed_fraction}"
            )
        if self.occupied.ndim != 1 or not (np.diff(self.occupied) > 0).all():
            raise ValueError("Frame.occupied must be ascending indices of voxels, each once")


@dataclass(frozen=True, eq=False)
class Replay:
    """An episode as it is drawn.

    Attributes
    ----------
    title : str
    grid : VoxelGrid
        The voxels of the map.
    target : (m, 3, 3) float array
        Triangles of the true target, metres.
    obstacles : (m, 3, 3) float array
        Triangles of all other true solids, without the ground, metres.
    vehicles : tuple of Vehicle
        One for each robot, at its true base pose.
    camera : DepthCamera
        The camera of each robot.
    frames : tuple of Frame
        The first one is the start, before any scan.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    title: str
    grid: VoxelGrid
    target: NDArray[np.float64]
    obstacles: NDArray[np.float64]
    vehicles: tuple[Vehicle, ...]
    camera: DepthCamera
    frames: tuple[Frame, ...]

    def __post_init__(self) -> None:
        for name in ("target", "obstacles"):
            shape = getattr(self, name).shape
            if len(shape) != 3 or shape[1:] != (3, 3):
                raise ValueError(f"Replay.{name} must be triangles (m, 3, 3), got {shape}")
        if len(self.target) == 0:
            raise ValueError("Replay.target must have triangles: the view is centered on it")
        if len(self.frames) < 2:
            raise ValueError(
                f"a replay needs a start and at least one scan, got {len(self.frames)}"
            )
        for k, frame in enumerate(self.frames):
            if len(frame.joints) != len(self.vehicles):
                raise ValueError(
                    f"frame {k} has {len(frame.joints)} robots and not {len(self.vehicles)}"
                )
            if len(frame.occupied) and not 0 <= frame.occupied[-1] < self.grid.n_cells:
                raise ValueError(f"frame {k}: voxel {frame.occupied[-1]} is outside of {self.grid}")


@overload
def record_replay(env: FieldEnv, policy: Policy, seed: int, title: str = "") -> Replay: ...


@overload
def record_replay(
    env: PlanarEnv, policy: Policy, seed: int, title: str = "", efficiency: bool = False
) -> PlanarReplay: ...


def record_replay(
    env: FieldEnv | PlanarEnv,
    policy: Policy,
    seed: int,
    title: str = "",
    efficiency: bool = False,
) -> Replay | PlanarReplay:
    """Play one episode, as `run_episode` does, and record what can be drawn of it.

    Parameters
    ----------
    env : FieldEnv or PlanarEnv
    policy : Policy
    seed : int
        Seed of the world.
    title : str
        By default the scene, the seed and the split.
    efficiency : bool
        Also bound what can be shown in the world, which takes seconds. Planar only, of an
        environment with ``report_shown=True``.

    Raises
    ------
    ValueError
        If an efficiency is asked for that the environment does not have.
    """
    if isinstance(env, PlanarEnv):
        return record_planar_replay(env, policy, seed, title, efficiency)
    if efficiency:
        raise ValueError("an efficiency needs bounds, which only planar worlds have")
    return _record_field_replay(env, policy, seed, title)


def _record_field_replay(env: FieldEnv, policy: Policy, seed: int, title: str) -> Replay:
    steps = rollout(env, policy, seed)
    robots = len(env.possible_agents)
    frames = [_make_frame(env, (0.0,) * robots, ("",) * robots)]
    for step in steps:
        notes = tuple(_note(env, agent, step.infos[agent]) for agent in env.possible_agents)
        rewards = tuple(float(step.rewards[agent]) for agent in env.possible_agents)
        frames.append(_make_frame(env, rewards, notes))
    world = env.truth
    obstacles = [s.triangles for s in world.solids if not (s.is_ground or s.is_target)]
    return Replay(
        title=title or f"{env.scene.name}, world {seed} of {env.split}",
        grid=world.grid,
        target=world.target_triangles,
        obstacles=np.concatenate([np.empty((0, 3, 3)), *obstacles]),
        vehicles=env.diagnostics.true_vehicles,
        camera=env.settings.camera,
        frames=tuple(frames),
    )


def _make_frame(env: FieldEnv, rewards: Sequence[float], notes: Sequence[str]) -> Frame:
    belief = env.belief()
    map_ = belief.map
    occupied = np.flatnonzero(map_.sampled_mask.view(np.bool_) & (map_.log_odds_fixed >= 0))
    return Frame(
        joints=tuple(np.array(q) for q in belief.joints),
        camera_poses=tuple(
            env.diagnostics.estimated_camera_pose(robot) for robot in range(len(belief.agents))
        ),
        occupied=occupied,
        observed_fraction=map_.observed_fraction,
        rewards=tuple(rewards),
        notes=tuple(notes),
    )


def _note(env: FieldEnv, agent: str, info: dict[str, Any]) -> str:
    """What kept the robot from doing what its action asked for."""
    if info["rejected_reason"]:
        return f"stayed: {env.explain(agent)['rejected_reason']}"
    if info["collided"]:
        return f"collided with {env.explain(agent)['collided']}"
    return "" if info["located"] else "not located yet"
