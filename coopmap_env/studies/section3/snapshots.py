"""Single episodes of the rating function, kept for figures."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import make_policy, rollout


@dataclass(frozen=True)
class EpisodeSnapshot:
    """A world, and the team map at the end of an episode in it."""

    truth: NDArray[np.bool_]
    """Occupied cells (nx, ny)."""
    probability: NDArray[np.float64]
    """P(occupied) of the map (nx, ny)."""
    sampled: NDArray[np.bool_]
    """Sampled cells of the map (nx, ny)."""
    paths: list[NDArray[np.float64]]
    """Camera positions of each robot (n_scans + 1, 2), in cells."""
    frame: NDArray[np.uint8]
    """The environment's last picture (H, W, 3)."""


def record_snapshot(max_scans: int, seed: int = 0, **env_kwargs: Any) -> EpisodeSnapshot:
    """Play one episode of the rating function (m = 100) on a world of the test split.

    Parameters
    ----------
    max_scans : int
        Scans of each robot.
    seed : int
        Seed of the world.
    **env_kwargs
        Further arguments of `PlanarEnv`.
    """
    env = PlanarEnv(split="test", max_scans=max_scans, render_mode="rgb_array", **env_kwargs)
    steps = rollout(env, make_policy("rating_function:search=100"), seed)
    grid = env.belief().map.grid
    paths = [[grid.to_cell_units(pose)] for pose in env.belief().camera_poses[:, :2]]
    for _ in steps:
        for path, pose in zip(paths, env.belief().camera_poses[:, :2], strict=True):
            path.append(grid.to_cell_units(pose))
    map_, frame = env.belief().map, env.render()
    assert frame is not None
    return EpisodeSnapshot(
        truth=env.truth.occupied,
        probability=map_.probability,
        sampled=map_.sampled,
        paths=[np.array(path) for path in paths],
        frame=frame,
    )
