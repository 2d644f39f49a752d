"""Random valid actions, some of them directed to what uniform ones seldom meet."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs import MappingEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.geometry import to_camera_frame
from coopmap_env.robots import free_mask

WISHES = {
    "any": 0.15,
    "feasible": 0.35,
    "collision": 0.3,
    "outside": 0.05,
    "unknown": 0.05,
    "not free": 0.05,
    "no path": 0.05,
}
"""How often an action is asked to meet what. What cannot be met becomes a uniform action."""
_NAMES, _UP_TO = list(WISHES), np.cumsum(list(WISHES.values()))
N_CELLS = 200
"""Random cells within reach among which one that meets a wish is sought."""


class ActionMaker:
    """Actions of all robots of a world.

    It knows the truth: a camera is sent into cells that are occupied, and mapped as free.

    Parameters
    ----------
    rng : numpy.random.Generator
    """

    def __init__(self, rng: np.random.Generator) -> None:
        self._rng = rng

    def __call__(self, env: MappingEnv[Any]) -> NDArray[Any]:
        """Valid actions (n_robots, ...) of an environment; arbitrary ones after its end."""
        actions = [self._action(env, robot) for robot in range(len(env.possible_agents))]
        return np.array(actions)

    def _action(self, env: MappingEnv[Any], robot: int) -> Any:
        wish = _NAMES[np.searchsorted(_UP_TO, self._rng.uniform(0.0, _UP_TO[-1]))]
        space = env.action_space(env.possible_agents[robot])
        action = None
        if env.agents and wish != "any":
            if isinstance(space, spaces.Discrete):
                action = self._choice(env, robot, wish, int(space.n))
            else:
                action = self._pose(env, robot, wish)
        if action is not None:
            return action
        if isinstance(space, spaces.Discrete):
            return self._rng.integers(int(space.n))
        return self._rng.uniform(-1, 1, space.shape).astype(np.float32)

    def _choice(self, env: MappingEnv[Any], robot: int, wish: str, m: int) -> Any:
        """A candidate: one in an occupied cell, a masked one, or a feasible one."""
        candidates = env.belief().candidates
        assert candidates is not None
        offered = candidates[robot]
        if wish == "collision" and isinstance(env, PlanarEnv):
            cells = offered // env.belief().lattice.n_headings
            return self._one(np.flatnonzero(env.truth.occupied.ravel()[cells]))
        if wish in ("feasible", "collision"):
            return self._one(np.arange(len(offered)))
        return self._one(np.arange(len(offered), m))

    def _pose(self, env: MappingEnv[Any], robot: int, wish: str) -> Any:
        belief = env.belief()
        if wish == "feasible" or not isinstance(env, PlanarEnv):
            poses = belief.random_poses(robot, 1, self._rng)
            return belief.actions.encode(robot, poses[0], belief) if len(poses) else None
        if wish == "outside":
            return self._outside(env, robot)
        cell = self._one(self._cells(env, robot, wish))
        if cell is None:
            return None
        n = belief.lattice.n_headings
        return belief.actions.encode(robot, int(cell) * n + int(self._rng.integers(n)), belief)

    def _cells(self, env: PlanarEnv, robot: int, wish: str) -> NDArray[np.int64]:
        """Some cells within reach that meet a wish; all cells for collisions."""
        belief = env.belief()
        feasible = belief.feasible_cells(robot)
        if wish == "collision":
            return feasible[env.truth.occupied.ravel()[feasible]]
        grid = belief.map.grid
        reach = int(env.settings.reach / grid.resolution)
        own = np.array(np.unravel_index(belief.cell(robot), grid.shape))
        offsets = self._rng.integers(-reach, reach + 1, (N_CELLS, 2))
        near = own + offsets[np.hypot(*offsets.T) < reach]
        cells = grid.flat_index(near[grid.contains(near)])
        sampled, free = belief.map.sampled_mask[cells] != 0, free_mask(belief.map)[cells]
        meets = {
            "unknown": ~sampled,
            "not free": sampled & ~free,
            "no path": free & ~np.isin(cells, feasible),
        }
        return cells[meets[wish]]

    def _outside(self, env: PlanarEnv, robot: int) -> Any:
        """A pose half a cell beyond the nearest border; None if none is within reach."""
        belief, scene = env.belief(), env.scene
        pose = belief.camera_poses[robot].copy()
        lower = np.array(scene.origin)
        upper = lower + np.array(scene.shape) * scene.resolution
        beyond = np.concatenate([lower - pose[:2], upper - pose[:2]])
        side = int(np.abs(beyond).argmin())
        step = beyond[side] + np.copysign(scene.resolution / 2, beyond[side])
        if abs(step) > env.settings.reach:
            return None
        pose[side % 2] += step
        relative = to_camera_frame(pose, belief.camera_poses[robot])
        scale = [env.settings.reach, env.settings.reach, np.pi]
        return np.clip(relative / scale, -1, 1).astype(np.float32)

    def _one(self, values: NDArray[Any]) -> Any:
        """One of the values; None if there are none."""
        return self._rng.choice(values) if len(values) else None
