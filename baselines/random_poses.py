"""Random poses: the lower bound of every comparison."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines.planner import Planner
from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask


class RandomPolicy(Planner):
    """Any feasible pose, uniformly at random."""

    def __init__(self) -> None:
        super().__init__(1, "independent")

    def score(
        self, belief: Belief, robot: int, poses: Poses, reserved_mask: ReservedMask | None
    ) -> NDArray[np.float64]:
        """Random scores, so that a choice among candidates is random too."""
        return self.rng.random(len(poses))
