"""Rewards: named terms, each a small function of the outcome of one robot's step.

Where teammates scan the same cells in a step, the overlap is paid once, to the robot of the lower
index: "rating" does not count the cells in view of earlier robots for a robot, "information",
"coverage" and "shown" count what a scan adds to the scans of earlier robots.

"shown" depends on the true world, and not on the map alone: it is for training. Robots do not know
it, and only environments that keep what scans show have it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.kernels import kernel
from coopmap_env.envs.arguments import TRUE_TERMS, RewardName
from coopmap_env.mapping import ScanGain


class StepOutcome(NamedTuple):
    """Outcome of one robot's step."""

    new_information: float
    """NI (Eqs. 6-8) of the executed pose on the map before the scans, without the cells that
    earlier robots see; nats."""
    distance: float
    """d of Eq. 5 that the camera moved."""
    motion_cost: float
    """K d**n of Eq. 9, nats."""
    rating: float
    """RF (Eq. 9) of the executed pose, from this NI."""
    gain: ScanGain
    """What the scan added to the map."""
    collision_cost: float = 0.0
    """Cost of a collision, as a fraction of the largest NI; 0 without a collision."""
    newly_shown: int = 0
    """Cells that the scan truly showed first; 0 where that is not kept."""


class RewardScale(NamedTuple):
    """Normalization of the terms."""

    full_view_entropy: float
    """Entropy of all cells that the camera can see, N ln 2, nats."""
    max_information: float
    """The largest NI, ln(n_gray_bins), nats."""
    n_cells: int
    """Cells of the world."""

    @classmethod
    def for_camera(cls, max_visible_cells: int, n_gray_bins: int, n_cells: int) -> RewardScale:
        """The scale of a camera that sees at most `max_visible_cells` of `n_cells` cells."""
        return cls(max_visible_cells * log(2.0), log(n_gray_bins), n_cells)


@kernel
def rating(outcome: StepOutcome, scale: RewardScale) -> float:
    """Eq. 9 of the executed pose on the map before the scan: what the planner maximises; nats."""
    return outcome.rating - outcome.collision_cost * scale.max_information


@kernel
def information(outcome: StepOutcome, scale: RewardScale) -> float:
    """Realised drop of map entropy minus the motion cost.

    The drop as a fraction of a full view's entropy, the cost as a fraction of the largest NI.
    """
    motion_cost = outcome.motion_cost / scale.max_information
    return (
        outcome.gain.entropy_reduction / scale.full_view_entropy
        - motion_cost
        - outcome.collision_cost
    )


@kernel
def coverage(outcome: StepOutcome, scale: RewardScale) -> float:
    """Newly observed cells as a fraction of the world."""
    return outcome.gain.new_cells / scale.n_cells - outcome.collision_cost


@kernel
def shown(outcome: StepOutcome, scale: RewardScale) -> float:
    """Cells that beams without noise crossed first, as a fraction of the world.

    It is what evaluations count as `shown`: without collisions, the sum over an episode is their
    increase.
    """
    return outcome.newly_shown / scale.n_cells - outcome.collision_cost


REWARD_TERMS: dict[RewardName, Callable[[StepOutcome, RewardScale], float]] = {
    "rating": rating,
    "information": information,
    "coverage": coverage,
    "shown": shown,
}
"""All terms by name; `RewardName` names them too."""


@kernel
def write_reward_terms(outcome: StepOutcome, scale: RewardScale, out: NDArray[np.float64]) -> None:
    """Write every term (terms,), in the order of `REWARD_TERMS`."""
    out[0] = rating(outcome, scale)
    out[1] = information(outcome, scale)
    out[2] = coverage(outcome, scale)
    out[3] = shown(outcome, scale)


def reward_terms(
    outcome: StepOutcome, scale: RewardScale, keeps_shown: bool = False
) -> dict[str, float]:
    """Every term by its name; see `name_terms`."""
    out = np.full(len(REWARD_TERMS), np.nan)
    write_reward_terms(outcome, scale, out)
    return name_terms(out, keeps_shown)


def name_terms(terms: NDArray[np.float64], keeps_shown: bool) -> dict[str, float]:
    """Terms (terms,) by their names; without `TRUE_TERMS` where what is shown is not kept."""
    named = zip(REWARD_TERMS, terms.tolist(), strict=True)
    return {name: term for name, term in named if keeps_shown or name not in TRUE_TERMS}
