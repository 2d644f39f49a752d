"""Episodes of the planar environment, recorded frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.bounds import PlanarViews, bound_shown, scans_in_time
from coopmap_env.evaluation.policy import Policy
from coopmap_env.evaluation.rollout import rollout
from coopmap_env.mapping import OccupancyMap
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import PlanarWorld

LARGEST_LEVEL = 254
"""Level of a cell that is surely occupied; 0 is surely free."""
NEVER_SAMPLED_LEVEL = 255


@dataclass(frozen=True, eq=False)
class PlanarFrame:
    """What a team knew after a scan of each robot, and what happened before it.

    Attributes
    ----------
    poses : (n, 3) float array
        Camera of each robot: x and y in metres, heading in radians.
    beams : tuple of (b, 2) float arrays
        Ends of the beams of each robot's scan, metres; none at the start.
    hits : tuple of (b,) bool arrays
        Whether a beam ended at a surface.
    changed : (k,) int array
        Flat indices of the cells whose level is another one than in the frame before, ascending.
    levels : (k,) uint8 array
        Their levels now; see `occupancy_levels`.
    observed_fraction : float
        Fraction of the world's cells that were ever sampled.
    elapsed_time : float
        Seconds on the clock of the team.
    rewards : tuple of float
        Reward of each robot for this step.
    notes : tuple of str
        Why a robot stayed, or what it collided with; empty if neither.
    n_shown : int, optional
        Cells that the scans truly showed or that were known at the start.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    poses: NDArray[np.float64]
    beams: tuple[NDArray[np.float64], ...]
    hits: tuple[NDArray[np.bool_], ...]
    changed: NDArray[np.int64]
    levels: NDArray[np.uint8]
    observed_fraction: float
    elapsed_time: float
    rewards: tuple[float, ...]
    notes: tuple[str, ...]
    n_shown: int | None = None

    def __post_init__(self) -> None:
        parts = (self.poses, self.beams, self.hits, self.rewards, self.notes)
        counts = [len(part) for part in parts]
        if len(set(counts)) != 1:
            raise ValueError(
                f"poses, beams, hits, rewards and notes are needed for each robot, got {counts}"
            )
        for ends, hit in zip(self.beams, self.hits, strict=True):
            if ends.shape != (len(hit), 2):
                raise ValueError(
                    f"PlanarFrame.beams must be ends (b, 2) with as many hits, got {ends.shape} "
                    f"and {len(hit)}"
                )
        if not 0 <= self.observed_fraction <= 1:
            raise ValueError(
                "PlanarFrame.observed_fraction must be a fraction between 0 and 1, "
                f"got {self.observed_fraction}"
            )
        if self.changed.ndim != 1 or not (np.diff(self.changed) > 0).all():
            raise ValueError("PlanarFrame.changed must be ascending indices of cells, each once")
        if self.levels.shape != self.changed.shape or self.levels.dtype != np.uint8:
            raise ValueError(
                f"PlanarFrame.levels must be a uint8 for each of {len(self.changed)} changed "
                f"cells, got {self.levels.shape} of {self.levels.dtype}"
            )


@dataclass(frozen=True, eq=False)
class PlanarReplay:
    """An episode as it is drawn.

    Attributes
    ----------
    title : str
    world : PlanarWorld
        The truth.
    camera : PlanarCamera
        The camera of each robot.
    frames : tuple of PlanarFrame
        The first one is the start, before any scan.
    bounds : (n + 1,) int array, optional
        Most cells that any policy can show, before the first scan and after each.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    title: str
    world: PlanarWorld
    camera: PlanarCamera
    frames: tuple[PlanarFrame, ...]
    bounds: NDArray[np.int64] | None = None

    def __post_init__(self) -> None:
        if len(self.frames) < 2:
            raise ValueError(
                f"a replay needs a start and at least one scan, got {len(self.frames)} frames"
            )
        n_robots, n_cells = len(self.frames[0].poses), self.world.occupied.size
        for k, frame in enumerate(self.frames):
            if len(frame.poses) != n_robots:
                raise ValueError(f"frame {k} has {len(frame.poses)} robots and not {n_robots}")
            if len(frame.changed) and not 0 <= frame.changed[0] <= frame.changed[-1] < n_cells:
                raise ValueError(
                    f"frame {k}: cells {frame.changed[0]} to {frame.changed[-1]} are not all among "
                    f"the {n_cells} of the world"
                )
        if self.bounds is not None:
            if len(self.bounds) < len(self.frames):
                raise ValueError(
                    f"{len(self.frames)} frames need as many bounds, got {len(self.bounds)}"
                )
            if any(frame.n_shown is None for frame in self.frames):
                raise ValueError("bounds need PlanarFrame.n_shown, which they are compared with")

    def maps(self) -> Iterator[NDArray[np.uint8]]:
        """The levels (nx, ny) of the map at each frame, a new array each time."""
        levels = np.full(self.world.occupied.size, NEVER_SAMPLED_LEVEL, dtype=np.uint8)
        for frame in self.frames:
            levels[frame.changed] = frame.levels
            yield levels.reshape(self.world.shape).copy()

    def efficiency_curve(self) -> list[float | None] | None:
        """What is shown beyond the start as a fraction of what as many scans can show at most.

        None without bounds; a value is None as long as no more than the start can be shown.
        """
        if self.bounds is None:
            return None
        shown = np.array([frame.n_shown for frame in self.frames], dtype=np.int64)
        possible = self.bounds[: len(shown)] - shown[0]
        return [
            float(more / most) if most > 0 else None
            for more, most in zip(shown - shown[0], possible, strict=True)
        ]


def occupancy_levels(map_: OccupancyMap) -> NDArray[np.uint8]:
    """Levels (n_cells,) of a map: P(occupied) from 0 to 254, and 255 where never sampled."""
    levels = np.rint(LARGEST_LEVEL * map_.probability.ravel())
    return np.where(map_.sampled.ravel(), levels, NEVER_SAMPLED_LEVEL).astype(np.uint8)


def record_planar_replay(
    env: PlanarEnv, policy: Policy, seed: int, title: str = "", efficiency: bool = False
) -> PlanarReplay:
    """Play one episode; see `record_replay`."""
    if efficiency and not env.reports_shown:
        raise ValueError("an efficiency needs what scans show: make it with report_shown=True")
    steps = rollout(env, policy, seed)
    start = dict.fromkeys(env.possible_agents, 0.0)
    unknown = np.full(env.truth.occupied.size, NEVER_SAMPLED_LEVEL, dtype=np.uint8)
    frames = [_make_frame(env, unknown, start, 0.0)]
    bounds = _bounds(env) if efficiency else None
    levels = occupancy_levels(env.belief().map)
    for step in steps:
        elapsed_time = next(iter(step.infos.values()))["elapsed_time"]
        frames.append(_make_frame(env, levels, step.rewards, float(elapsed_time)))
        levels = occupancy_levels(env.belief().map)
    return PlanarReplay(
        title=title or f"{env.scene.name}, world {seed} of {env.split}",
        world=env.truth,
        camera=env.settings.camera,
        frames=tuple(frames),
        bounds=bounds,
    )


def _bounds(env: PlanarEnv) -> NDArray[np.int64]:
    """Most cells that can be shown from the start of the episode, scan by scan."""
    n_scans = scans_in_time(env.max_scans, env.max_time, env.settings.scan_time)
    return bound_shown(PlanarViews.from_env(env, n_scans), n_scans).bounds


def _make_frame(
    env: PlanarEnv,
    levels_before: NDArray[np.uint8],
    rewards: Mapping[str, float],
    elapsed_time: float,
) -> PlanarFrame:
    belief, scans = env.belief(), env.last_scans
    n_robots = len(belief.agents)
    levels = occupancy_levels(belief.map)
    changed = np.flatnonzero(levels != levels_before)
    return PlanarFrame(
        poses=belief.camera_poses.copy(),
        beams=tuple(scan.points.copy() for scan in scans) or (np.empty((0, 2)),) * n_robots,
        hits=tuple(scan.hit.copy() for scan in scans) or (np.empty(0, dtype=np.bool_),) * n_robots,
        changed=changed,
        levels=levels[changed],
        observed_fraction=belief.map.observed_fraction,
        elapsed_time=elapsed_time,
        rewards=tuple(float(rewards[agent]) for agent in belief.agents),
        notes=tuple(_note(env, agent) for agent in belief.agents),
        n_shown=int(env.shown_mask.sum()) if env.reports_shown else None,
    )


def _note(env: PlanarEnv, agent: str) -> str:
    """What kept the robot from doing what its action asked for."""
    words = env.explain(agent)
    if "rejected_reason" in words:
        return f"stayed: {words['rejected_reason']}"
    return f"collided with {words['collided']}" if "collided" in words else ""
