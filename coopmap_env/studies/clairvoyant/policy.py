"""Policies that know the true world and keep every constraint of one that does not."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import make_plain
from coopmap_env.core.settings import Bounds, PositiveInt, Settings
from coopmap_env.envs import Belief, Observation
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.evaluation.bounds import scans_in_time
from coopmap_env.robots import free_mask
from coopmap_env.robots.planar.feasible_poses import PoseSampling
from coopmap_env.studies.clairvoyant._timed_choices import Clock, Step
from coopmap_env.studies.clairvoyant._true_rollouts import BASE, count_best_views, play_on
from coopmap_env.studies.clairvoyant._true_scans import (
    FREE,
    HIDDEN,
    OCCUPIED,
    Progress,
    Scratch,
    TrueWorld,
    count_views,
    find_region,
    mark_views,
)


@dataclass(frozen=True)
class LookAhead(Settings):
    """How far and how wide a clairvoyant policy looks ahead."""

    n_scans: Annotated[int, Bounds(at_least=1, largest=10_000)] = 16
    """Scans of each robot that a plan has, the next one included; as many as are left, at most.
    Where time ends the episode, a plan lasts until then."""
    n_tried: PositiveInt = 16
    """Poses of each robot from which it plays on: the best of a block of cells each."""
    block: PositiveInt = 4
    """Cells along the side of a block."""


class Played(NamedTuple):
    """A plan, and what it shows."""

    plan: NDArray[np.int64]
    """Poses (h, n_robots)."""
    shown: NDArray[np.int64]
    """Cells, or samples of a surface, (h,) that each scan of the team newly shows."""

    @property
    def rank(self) -> tuple[int, int]:
        """Better plans show more in the end; of equal ones, those that show it earlier."""
        return int(self.shown.sum()), int(np.cumsum(self.shown).sum())


class ClairvoyantGreedy:
    """Each robot in turn takes the feasible pose that truly shows most new cells.

    Cells that the robots before it are about to show do not count again, and of poses that show as
    much it takes the one with the least motion. It scores what beams without noise show
    (``shown``), in "pose" and in "candidates" mode, and never goes to an occupied cell.

    Where time ends the episode, it takes the pose with which the team shows most for each second
    until its next scan ends: that of the slowest robot so far, or what is left if that is less.

    Parameters
    ----------
    env : PlanarEnv
        The environment in which it acts; its truth is read when the policy is reset.

    Raises
    ------
    ValueError
        If it is no planar environment.
    """

    def __init__(self, env: PlanarEnv) -> None:
        if not isinstance(env, PlanarEnv):
            raise ValueError(f"a clairvoyant policy needs a planar environment, got {env}")
        self._env = env

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode in the world that the environment has now; nothing is random."""
        belief, occupied = self._env.belief(), self._env.truth.occupied.ravel()
        grid, rating = belief.map.grid, belief.rating_function
        sampling = PoseSampling(rating.lattice.geometry, grid.shape_3d, float(belief.reach))
        self._world = TrueWorld(occupied, rating.fan.arrays(grid.shape[1]), sampling)
        self._plain_world = make_plain(self._world)
        self._scratch = make_plain(Scratch.empty(self._world))
        self._progress = Progress.empty(grid.n_cells, rating.lattice.n_headings, len(belief.agents))
        self._progress.cells[:] = HIDDEN
        self._progress.cells[occupied] |= OCCUPIED
        self._progress.cells[belief.map.sampled.ravel()] &= ~HIDDEN
        self._n_scans = 0

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """Choose the pose of each robot, as actions."""
        assert isinstance(belief, PlanarBelief)
        if self._n_scans:
            self._mark(self._progress.cells, belief.pose_ids)
        self._n_scans += 1
        poses = self._choose(belief)
        return {
            agent: belief.action_for(robot, pose)
            for robot, (agent, pose) in enumerate(zip(belief.agents, poses, strict=True))
        }

    def _choose(self, belief: PlanarBelief) -> list[int]:
        """A pose for each robot."""
        cells, chosen = self._progress.cells.copy(), list[int]()
        step = Step(0, 0.0)
        for robot in range(len(belief.agents)):
            poses, counts = self._count(belief, robot, cells)
            worth = _worth(belief, robot, poses, counts, step)
            k = np.lexsort((belief.distance(robot, poses), -worth))[0]
            chosen.append(int(poses[k]))
            step = _step_with(belief, robot, chosen[-1], int(counts[k]), step)
            self._mark(cells, chosen[-1:])
        return chosen

    def _count(
        self, belief: PlanarBelief, robot: int, cells: NDArray[np.uint8]
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Poses (k,) to which a robot can go without a collision, and what each newly shows."""
        offered = belief.candidates
        poses = belief.feasible_poses(robot) if offered is None else offered[robot]
        collides = self._world.occupied[poses // belief.lattice.n_headings]
        if not collides.all():  # all candidates may
            poses = poses[~collides]
        counts = np.empty(len(poses), dtype=np.int64)
        count_views(cells, self._plain_world, poses, counts)
        return poses, counts

    def _mark(self, cells: NDArray[np.uint8], pose_ids: Sequence[int] | NDArray[np.int64]) -> None:
        """The views from some poses are hidden no longer."""
        mark_views(cells, self._plain_world, np.array(pose_ids), self._scratch)


def _worth(
    belief: PlanarBelief,
    robot: int,
    poses: NDArray[np.int64],
    counts: NDArray[np.int64],
    step: Step,
) -> NDArray[Any]:
    """What poses (k,) are compared by: cells, or cells for each second where time is limited."""
    left = belief.budget.time
    if math.isinf(left):
        return counts
    seconds = np.maximum(belief.motion_time(robot, poses), step.slowest) + belief.scan_time
    worth: NDArray[np.float64] = (step.gain + counts) / np.minimum(seconds, left)
    return worth


def _step_with(belief: PlanarBelief, robot: int, pose: int, count: int, step: Step) -> Step:
    """The step of the team, with the pose of one more robot."""
    (motion,) = belief.motion_time(robot, [pose])
    return Step(step.gain + count, max(step.slowest, float(motion)))


class ClairvoyantLookAhead(ClairvoyantGreedy):
    """Plays plans of several scans in the true world, and begins the best one.

    A plan begins with one of many poses of a robot. From there on a base policy sends each robot in
    turn to the view that truly shows most for each scan that it takes to get there, also beyond its
    reach. Of all plans, and what is left of the plan before, the one is begun that shows most at
    its end.

    Where time ends the episode, plans last until then, and the base policy counts seconds instead
    of scans, as `ClairvoyantGreedy` does.

    The first scan of a plan goes by the belief. For later ones, what a scan of the plan truly shows
    as free counts as known to be free. The map needs P < 0.05, which noise may prevent in a few
    cells; then the pose is chosen again.

    In "candidates" mode later scans of a plan are not restricted to candidates, as these are not
    drawn yet.

    Parameters
    ----------
    env : PlanarEnv
        See `ClairvoyantGreedy`.
    settings : LookAhead, optional
    """

    def __init__(self, env: PlanarEnv, settings: LookAhead | None = None) -> None:
        super().__init__(env)
        self.settings = settings or LookAhead()

    def reset(self, rng: np.random.Generator) -> None:
        """See `ClairvoyantGreedy.reset`."""
        super().reset(rng)
        self._copy = tuple(part.copy() for part in self._progress)
        self._plan = np.empty((0, len(self._progress.pose_ids)), dtype=np.int64)
        self._count_best_views(np.flatnonzero(~self._world.occupied))

    def _choose(self, belief: PlanarBelief) -> list[int]:
        self._start_from(belief)
        best = self._first_plan(belief)
        for robot in range(len(belief.agents)):
            before = best.plan[0, :robot].copy()
            for pose in self._tried_poses(belief, robot, before):
                plan = np.full_like(best.plan, BASE)
                plan[0] = best.plan[0] if belief.candidates else BASE
                plan[0, :robot], plan[0, robot] = before, pose
                played = self._play(plan)
                if played.rank > best.rank:
                    best = played
        self._plan = best.plan[1:]
        chosen: list[int] = best.plan[0].tolist()
        return chosen

    def _start_from(self, belief: PlanarBelief) -> None:
        """Bring the progress up to date: where robots can go now, and what views near them show."""
        progress, shape = self._progress, belief.map.grid.shape_3d
        clock = Clock(float(belief.budget.time), float(belief.scan_time), belief.speeds)
        self._plain_clock = make_plain(clock)
        progress.cells[:] &= ~FREE
        progress.cells[free_mask(belief.map) & ~self._world.occupied] |= FREE
        progress.pose_ids[:] = belief.pose_ids
        progress.step[0] += 1
        queue = np.empty(len(progress.cells), dtype=np.int32)
        for robot, region in enumerate(progress.regions):
            find_region(progress.cells, region, shape, belief.cell(robot), queue)
        if self._n_scans > 1:
            xy, side = np.indices(shape[:2]).reshape(2, -1), 2 * self._world.fan.max_offset
            near = np.zeros(len(progress.cells), dtype=np.bool_)
            for robot in range(len(belief.agents)):
                at = np.array(divmod(belief.cell(robot), shape[1]))
                near |= (np.abs(xy - at[:, None]) <= side).all(axis=0)
            self._count_best_views(np.flatnonzero(near & (progress.gains > 0)))

    def _count_best_views(self, cells: NDArray[np.int64]) -> None:
        count_best_views(self._plain_world, make_plain(self._progress), self._scratch, cells)

    def _first_plan(self, belief: PlanarBelief) -> Played:
        """The best of what is left of the plan before and those that try nothing."""
        n_robots = len(belief.agents)
        scans, seconds = belief.budget
        if math.isinf(seconds):
            n = min(self.settings.n_scans, scans)
        else:
            n = scans_in_time(scans, seconds, belief.scan_time)
        empty = np.full((n, n_robots), BASE)
        greedy = empty.copy()
        greedy[0] = super()._choose(belief)
        if belief.candidates:
            return self._play(greedy)
        left = np.concatenate([self._plan, empty])[:n]
        for robot, pose in enumerate(left[0]):
            if pose // belief.lattice.n_headings not in belief.feasible_cells(robot):
                left[0, robot] = BASE
        return max(map(self._play, (left, empty, greedy)), key=lambda played: played.rank)

    def _tried_poses(
        self, belief: PlanarBelief, robot: int, before: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """The poses of a robot that are worth most beside `before`, of each block the best one."""
        cells, step = self._progress.cells.copy(), Step(0, 0.0)
        for other, pose in enumerate(before):
            step = _step_with(belief, other, int(pose), 0, step)
        self._mark(cells, before)
        poses, counts = self._count(belief, robot, cells)
        order = np.argsort(-_worth(belief, robot, poses, counts, step), kind="stable")
        at, ny = poses[order] // belief.lattice.n_headings, belief.map.grid.shape[1]
        blocks = at // ny // self.settings.block * ny + at % ny // self.settings.block
        _, first = np.unique(blocks, return_index=True)
        tried: NDArray[np.int64] = poses[order[np.sort(first)[: self.settings.n_tried]]]
        return tried

    def _play(self, plan: NDArray[np.int64]) -> Played:
        """Play a plan, whose BASE poses are filled in."""
        shown = np.empty(len(plan), dtype=np.int64)
        play_on(
            make_plain(self._progress), self._plain_world, self._copy, self._scratch,
            self._plain_clock, plan, shown,
        )  # fmt: skip
        return Played(plan, shown)
