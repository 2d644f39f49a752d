"""What a planar team has to do, and with what."""

from __future__ import annotations

from typing import NamedTuple

from coopmap_env.envs.arguments import RewardName
from coopmap_env.envs.planar.settings import PlanarSettings
from coopmap_env.mapping import VoxelGrid


class PlanarTask(NamedTuple):
    """The same in all worlds."""

    grid: VoxelGrid
    settings: PlanarSettings
    n_robots: int
    n_candidates: int
    """m; 0 in "pose" mode."""
    reward: RewardName
    is_reward_shared: bool
    keeps_shown: bool = False
    """Whether what scans truly show is kept, to report it or to pay for it."""
