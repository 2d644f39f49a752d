"""Episodes in the field, recorded frame by frame, and written as a page to look at."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import write_atomically
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.rollout import policy_rng
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import Vehicle
from coopmap_env.sensing import DepthCamera


@dataclass(frozen=True, eq=False)
class Frame:
    """What a team knew after a scan of each robot, and what happened on the way there.

    Attributes
    ----------
    joints : tuple of (n,) float arrays
        Of each robot's mount, as its encoders say.
    camera_poses : tuple of Pose
        T_world_camera of each robot, where it takes it to be.
    occupied : (k,) int array
        Flat numbers of the sampled voxels with P >= 1/2, ascending.
    observed_fraction : float
        Share of the world's voxels that were ever sampled.
    rewards : tuple of float
        Of each robot, for this step.
    notes : tuple of str
        Of each robot: why it stayed or what it bumped into; empty if nothing.

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
                f"Frame.observed_fraction must be a fraction between 0 and 1, got {self.observed_fraction}"
            )
        if self.occupied.ndim != 1 or not (np.diff(self.occupied) > 0).all():
            raise ValueError("Frame.occupied must be ascending numbers of voxels, each once")


@dataclass(frozen=True, eq=False)
class Replay:
    """An episode as it can be looked at.

    Attributes
    ----------
    title : str
    grid : VoxelGrid
        The voxels of the map.
    target : (m, 3, 3) float array
        Triangles of the true target, metres.
    obstacles : (m, 3, 3) float array
        Triangles of all else that truly stands there, without the ground.
    vehicles : tuple of Vehicle
        One for each robot, where it truly stands.
    camera : DepthCamera
        What each of them carries.
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
            raise ValueError("Replay.target must have triangles: the view is turned to it")
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


def record_replay(env: FieldEnv, policy: Policy, seed: int, title: str = "") -> Replay:
    """Play one episode, as `run_episode` does, and keep what there is to see of it."""
    observations, _ = env.reset(seed=seed)
    policy.reset(policy_rng(seed))
    robots = len(env.possible_agents)
    frames = [_make_frame(env, (0.0,) * robots, ("",) * robots)]
    while env.agents:
        observations, rewards, _, _, infos = env.step(policy.act(env.belief(), observations))
        notes = tuple(_note(infos[agent]) for agent in env.possible_agents)
        step_rewards = tuple(float(rewards[agent]) for agent in env.possible_agents)
        frames.append(_make_frame(env, step_rewards, notes))
    world = env.truth
    obstacles = [s.triangles for s in world.solids if not (s.is_ground or s.is_target)]
    return Replay(
        title=title or f"{env.scene.name}, world {seed} of {env.split}",
        grid=world.grid,
        target=world.target_triangles,
        obstacles=np.concatenate([np.empty((0, 3, 3)), *obstacles]),
        vehicles=env.true_vehicles,
        camera=env.settings.camera,
        frames=tuple(frames),
    )


def write_replay(replay: Replay, path: Path) -> None:
    """Write one HTML page that needs nothing else, not even a network.

    Raises
    ------
    ImportError
        If viser is not installed (extra "replay").
    """
    from coopmap_env.evaluation.replay.page import render_page

    write_atomically(Path(path), render_page(replay))


def _make_frame(env: FieldEnv, rewards: Sequence[float], notes: Sequence[str]) -> Frame:
    belief = env.belief()
    map_ = belief.map
    occupied = np.flatnonzero(map_.sampled_mask.view(np.bool_) & (map_.log_odds_fixed >= 0))
    return Frame(
        joints=tuple(np.array(q) for q in belief.joints),
        camera_poses=tuple(env.estimated_camera_pose(robot) for robot in range(len(belief.agents))),
        occupied=occupied,
        observed_fraction=map_.observed_fraction,
        rewards=tuple(rewards),
        notes=tuple(notes),
    )


def _note(info: dict[str, Any]) -> str:
    """What went otherwise than the robot wanted."""
    if info["rejected_reason"]:
        return f"stayed: {info['rejected_reason']}"
    if info["contact"]:
        return f"bumped into {info.get('touched') or 'something'}"
    return "" if info["located"] else "has not found the target yet"
