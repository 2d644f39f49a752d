"""Policies that know the true field world and keep every constraint of one that does not."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from coopmap_env.core.kernels import make_plain
from coopmap_env.core.settings import PositiveInt, Settings
from coopmap_env.envs import Belief, Observation
from coopmap_env.envs.field import FieldEnv
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.evaluation.bounds import FieldViews, scans_in_time
from coopmap_env.evaluation.metrics import SurfaceEvaluator
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import CollisionChecker
from coopmap_env.studies.clairvoyant._true_views import BASE, TrueViews, choose_step, play_on
from coopmap_env.studies.clairvoyant.policy import Played

N_DRAWN = 300
"""Poses of each robot that are drawn beside home and the grid of its joint space."""


def true_pose_sets(
    env: FieldEnv, rng: np.random.Generator, n_drawn: int = N_DRAWN
) -> list[NDArray[np.float64]]:
    """Poses (k, n) of each robot, among which clairvoyant field policies choose.

    They are those of home, of the grid of the joint space and of `n_drawn` that are drawn from it,
    at which the mount touches nothing in the true world; home, if there is none. All are poses
    that a "pose" action can have.
    """
    true_map, occupied = OccupancyMap(env.truth.grid), env.truth.occupied.ravel()
    true_map.mark_free(np.flatnonzero(~occupied))
    true_map.mark_occupied(np.flatnonzero(occupied))
    sets = []
    spaces, vehicles = env.belief().joint_spaces, env.diagnostics.true_vehicles
    for space, vehicle in zip(spaces, vehicles, strict=True):
        home = space.denormalize(space.normalize(vehicle.mount.home))
        poses = np.vstack([home, space.grid(), space.sample(n_drawn, rng)])
        checker = CollisionChecker(vehicle, true_map, settings=env.settings.motion)
        is_free = checker.are_poses_free(poses)
        sets.append(poses[is_free] if is_free.any() else poses[:1])
    return sets


def surface_views(
    env: FieldEnv,
    rng: np.random.Generator,
    n_drawn: int = N_DRAWN,
    evaluator: SurfaceEvaluator | None = None,
) -> FieldViews:
    """What the poses of `true_pose_sets` truly cover, for as many scans as an episode can have.

    Without an evaluator, what counts are samples of the visible surface that `rng` draws.
    """
    joints = true_pose_sets(env, rng, n_drawn)
    if evaluator is None:
        vehicles = env.diagnostics.true_vehicles
        evaluator = SurfaceEvaluator(env.truth, vehicles, env.settings.camera, rng)
    n_scans = scans_in_time(env.max_scans, env.max_time, env.settings.scan_time)
    return FieldViews.of_surface(env, evaluator, n_scans, joints)


@dataclass(frozen=True)
class FieldLookAhead(Settings):
    """How wide a clairvoyant field policy looks ahead."""

    n_tried: PositiveInt = 24
    """Poses of each robot from which it plays on, at each decision: the best of a block of the
    joint space each."""


class ClairvoyantFieldGreedy:
    """Each robot in turn takes the pose that truly covers most new surface.

    It chooses among poses of a finite set (`true_pose_sets`) that are feasible on the map. What
    counts is the covered surface (`SurfaceEvaluator.coverage`): what scans without noise from the
    true camera poses would add to that of the team's map. What the robots before it are about to
    cover does not count again, and of poses that cover as much it takes the one with the shortest
    motion. It knows neither the errors of encoders nor where moving teammates are in the way.

    Where the clock of the team may run out (``max_time``), it first decides how long the motions of
    this step may take: for the most new samples per second of the clock.

    Parameters
    ----------
    env : FieldEnv
        The environment in which it acts, in "pose" mode; its truth is read when the policy is
        reset.
    views_for : callable, optional
        Gives what the poses of the set cover in the environment's world, by random numbers; by
        default `surface_views`.

    Raises
    ------
    ValueError
        If it is no field environment; from `act`, if the belief has candidates.
    """

    def __init__(
        self,
        env: FieldEnv,
        views_for: Callable[[np.random.Generator], FieldViews] | None = None,
    ) -> None:
        if not isinstance(env, FieldEnv):
            raise ValueError(f"a clairvoyant field policy needs a field environment, got {env}")
        self._env = env
        self._views_for = views_for or partial(surface_views, env)

    def reset(self, rng: np.random.Generator) -> None:
        """Start an episode in the environment's world; `rng` draws poses and samples."""
        env, views = self._env, self._views_for(rng)
        self._joints, self._blocks = views.joints, views.blocks
        self._samples = views.voxels
        vehicles = env.diagnostics.true_vehicles
        speeds = [vehicle.chain.max_speeds for vehicle in vehicles]
        self._views = TrueViews.from_sets(
            views.sets, len(views.voxels), views.joints, speeds, float(env.settings.scan_time)
        )
        self._plain_views = make_plain(self._views)

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """Choose the pose of each robot, as actions."""
        assert isinstance(belief, FieldBelief)
        if belief.candidates is not None:
            raise ValueError("a clairvoyant field policy acts in 'pose' mode, not on candidates")
        chosen = self._choose(belief)
        return {
            agent: belief.action_for(robot, self._pose(belief, robot, int(chosen[robot])))
            for robot, agent in enumerate(belief.agents)
        }

    def _choose(self, belief: FieldBelief) -> NDArray[np.int64]:
        """A pose for each robot; BASE where none is possible."""
        covered, chosen = self._covered(belief), np.full(len(belief.agents), BASE)
        times = [belief.motion_time(robot, own) for robot, own in enumerate(self._joints)]
        choose_step(
            self._plain_views, self._possible(belief), np.concatenate(times), covered,
            self._count(covered), belief.budget.time, chosen,
        )  # fmt: skip
        return chosen

    def _possible(self, belief: FieldBelief) -> NDArray[np.bool_]:
        """Which poses (k,) the robots can go to now."""
        feasible = [
            belief.reachability.collision_free(robot, own) for robot, own in enumerate(self._joints)
        ]
        return np.concatenate(feasible)

    def _covered(self, belief: FieldBelief) -> NDArray[np.bool_]:
        """Which samples (n,) the team's map covers."""
        arrays, shape = belief.map.arrays, belief.map.grid.shape_3d
        occupied = (arrays.log_odds_fixed > 0) & (arrays.sampled_mask != 0)
        beside = ndimage.binary_dilation(occupied.reshape(shape), np.ones((3, 3, 3)))
        covered: NDArray[np.bool_] = beside.ravel()[self._samples]
        return covered

    def _count(self, covered: NDArray[np.bool_]) -> NDArray[np.int64]:
        """What each pose (k,) newly covers."""
        counts = np.concatenate([[0], np.cumsum(~covered[self._views.cells])])
        gains: NDArray[np.int64] = np.diff(counts[self._views.start])
        return gains

    def _pose(self, belief: FieldBelief, robot: int, pose: int) -> NDArray[np.float64]:
        if pose == BASE:
            return belief.joints[robot]
        return self._joints[robot][pose - int(self._views.first[robot])]


class ClairvoyantFieldLookAhead(ClairvoyantFieldGreedy):
    """Plays plans to the end of the episode in the true world, and begins the best one.

    A plan begins with one of many poses of a robot; the greedy policy does the rest. Poses of the
    first scan are feasible on the map; those of later ones are free at their end in the true
    world, and are chosen again when their time comes. Of all plans, and what is left of the plan
    before, the one is begun that covers most at its end.

    Parameters
    ----------
    env, views_for
        See `ClairvoyantFieldGreedy`.
    settings : FieldLookAhead, optional
    """

    def __init__(
        self,
        env: FieldEnv,
        views_for: Callable[[np.random.Generator], FieldViews] | None = None,
        settings: FieldLookAhead | None = None,
    ) -> None:
        super().__init__(env, views_for)
        self.settings = settings or FieldLookAhead()

    def reset(self, rng: np.random.Generator) -> None:
        """See `ClairvoyantFieldGreedy.reset`."""
        super().reset(rng)
        self._plan = np.empty((0, len(self._joints)), dtype=np.int64)

    def _choose(self, belief: FieldBelief) -> NDArray[np.int64]:
        scans, seconds = belief.budget
        n = scans_in_time(scans, None if math.isinf(seconds) else seconds, belief.scan_time)
        empty = np.full((n, len(belief.agents)), BASE)
        covered, possible = self._covered(belief), self._possible(belief)
        is_possible = possible, np.ones_like(possible)
        gains, joints = self._count(covered), self._padded(belief)

        def play(plan: NDArray[np.int64]) -> Played:
            shown = np.zeros(n, dtype=np.int64)
            played = play_on(
                self._plain_views, is_possible, joints, covered.copy(), gains.copy(), seconds, plan,
                shown,
            )  # fmt: skip
            return Played(plan[:played], shown[:played])

        left = np.concatenate([self._plan, empty])[:n]
        best = max(play(left), play(empty.copy()), key=lambda one: one.rank)
        for robot in range(len(belief.agents)):
            before = best.plan[0, :robot].copy()
            for pose in self._tried_poses(belief, robot, possible, gains):
                plan = empty.copy()
                plan[0, :robot], plan[0, robot] = before, pose
                best = max(best, play(plan), key=lambda one: one.rank)
        self._plan = best.plan[1:]
        chosen: NDArray[np.int64] = best.plan[0]
        return chosen

    def _padded(self, belief: FieldBelief) -> NDArray[np.float64]:
        """Joints of all robots as rows (n_robots, n)."""
        out = np.zeros((len(belief.agents), self._views.joints.shape[1]))
        for row, own in zip(out, belief.joints, strict=True):
            row[: len(own)] = own
        return out

    def _tried_poses(
        self,
        belief: FieldBelief,
        robot: int,
        possible: NDArray[np.bool_],
        gains: NDArray[np.int64],
    ) -> NDArray[np.int64]:
        """The best possible poses of a robot, of each block of its joint space one."""
        first, end = self._views.first[robot : robot + 2]
        poses = first + np.flatnonzero(possible[first:end])
        worth = gains[poses].astype(np.float64)
        if not math.isinf(belief.budget.time):
            worth /= (
                belief.motion_time(robot, self._joints[robot][poses - first]) + belief.scan_time
            )
        order = np.argsort(-worth, kind="stable")
        _, at = np.unique(self._blocks[poses[order]], return_index=True)
        tried: NDArray[np.int64] = poses[order[np.sort(at)[: self.settings.n_tried]]]
        return tried
