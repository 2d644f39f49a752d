"""Joint paths of several straight motions, by OMPL."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.robots.collision.checker import CollisionChecker


def plan_path(
    checker: CollisionChecker,
    start: ArrayLike,
    goal: ArrayLike,
    seed: int,
    iterations: int = 300,
) -> NDArray[np.float64] | None:
    """A path from `start` to `goal` of which each straight motion is free, if one is found.

    The straight motion if that is free; else RRT-Connect (Kuffner and LaValle 2000) over the
    mount's joints, shortened by leaving out waypoints. The same seed gives the same path: the
    number of steps is limited, not the time.

    Parameters
    ----------
    surroundings : CollisionChecker
    start, goal : array_like, shape (n,)
        Joint values.
    seed : int
        At least 1.
    iterations : int, optional
        Steps of the search, at 0.1 to 0.5 ms each.

    Returns
    -------
    ndarray, shape (w, n), or None
        Waypoints from start to goal, both included.

    Raises
    ------
    ImportError
        If the `paths` extra is not installed.
    ValueError
        If joint values are of another shape or out of the limits, or seed or iterations below 1.
    """
    if seed < 1 or iterations < 1:
        raise ValueError(f"seed and iterations must be at least 1, got {seed} and {iterations}")
    chain = checker.vehicle.chain
    q0, q1 = chain.as_joint_values(start), chain.check_limits(goal)
    import_optional("ompl", "paths")
    contact = checker.first_contact(q0, q1, goal_first=True)
    if contact is None:
        return np.stack([q0, q1])
    if contact.at_goal:
        return None
    # an encoder reading at the end of a joint's range may lie slightly outside of its limits
    inside = np.clip(q0, chain.lower, chain.upper)
    found = _rrt_connect(checker, inside, q1, seed, iterations)
    return None if found is None else np.concatenate([[q0], _shortcut_path(checker, found)[1:]])


def _rrt_connect(
    checker: CollisionChecker,
    q0: NDArray[np.float64],
    q1: NDArray[np.float64],
    seed: int,
    iterations: int,
) -> NDArray[np.float64] | None:
    base, geometric = (
        import_optional("ompl.base", "paths"),
        import_optional("ompl.geometric", "paths"),
    )
    util = import_optional("ompl.util", "paths")
    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed)  # seeds all generators made from here on: the sampler's, the planner's
    chain = checker.vehicle.chain
    n = chain.n_joints
    space = base.RealVectorStateSpace(n)
    bounds = base.RealVectorBounds(n)
    for j in range(n):
        full_turn = 2.0 * math.pi  # of joints without limits
        bounds.setLow(j, float(max(chain.lower[j], -full_turn)))
        bounds.setHigh(j, float(min(chain.upper[j], full_turn)))
    space.setBounds(bounds)
    information = base.SpaceInformation(space)

    def values(state: Any) -> NDArray[np.float64]:
        return np.array([state[j] for j in range(n)])

    def is_valid(state: Any) -> bool:
        q = values(state)
        return bool((q == q0).all() or (q == q1).all() or checker.are_poses_free(q)[0])

    class Validator(base.MotionValidator):  # type: ignore[name-defined]
        def checkMotion(self, one: Any, other: Any, *_: Any) -> bool:  # noqa: N802
            """OMPL's name for whether a straight motion is free."""
            return bool(checker.are_motions_free(values(one), values(other))[0])

    validator = Validator(information)
    information.setStateValidityChecker(is_valid)
    information.setMotionValidator(validator)
    information.setup()
    problem = base.ProblemDefinition(information)
    ends = []
    for q in (q0, q1):
        state = space.allocState()
        for j in range(n):
            state[j] = float(q[j])
        ends.append(state)
    problem.setStartAndGoalStates(*ends)
    planner = geometric.RRTConnect(information)
    planner.setProblemDefinition(problem)
    planner.setup()
    left = iter(range(iterations))
    planner.solve(base.PlannerTerminationCondition(lambda: next(left, None) is None))
    if not problem.hasExactSolution():
        return None
    path = problem.getSolutionPath()
    return np.array([values(path.getState(i)) for i in range(path.getStateCount())])


def _shortcut_path(checker: CollisionChecker, path: NDArray[np.float64]) -> NDArray[np.float64]:
    """Leave out waypoints: go straight from each to the last one that a free motion reaches."""
    kept, at = [0], 0
    while at < len(path) - 1:
        free = checker.are_motions_free(path[at], path[at + 1 :])
        at += 1 + (int(np.flatnonzero(free)[-1]) if free.any() else 0)
        kept.append(at)
    return path[kept]
