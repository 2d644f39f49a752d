"""One step of a team as data: its seeds, the motion, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from coopmap_env.envs.belief import Belief, Observation
from coopmap_env.envs.rewards import REWARD_TERMS, StepOutcome
from coopmap_env.simulation.scenes import world_seed

BeliefT = TypeVar("BeliefT", bound=Belief)
Infos = dict[str, dict[str, Any]]
"""Info of each agent."""


RESET_INFO_TYPES: dict[str, Any] = {"n_scans": int, "observed_fraction": float}
"""Type of each entry of a robot's info after a reset, without the action mask; see
`coopmap_env.vector`."""
STEP_INFO_TYPES: dict[str, Any] = {
    **RESET_INFO_TYPES,
    "rejected_reason": str,
    "collided": bool,
    "reward_terms": dict.fromkeys(REWARD_TERMS, float),
    "new_information": float,
    "distance": float,
    "new_cells": int,
    "entropy_reduction": float,
}
"""The same after a step; `outcome_info` fills it in."""


class EpisodeSeeds(NamedTuple):
    """The seeds of an episode, one for each purpose."""

    scene: np.random.SeedSequence
    start: np.random.SeedSequence
    noise: np.random.SeedSequence
    candidates: np.random.SeedSequence
    seeds: np.random.SeedSequence
    """Draws the seeds of later resets without a seed."""
    vehicles: np.random.SeedSequence
    """Draws how true vehicles differ from their descriptions."""

    @classmethod
    def of_episode(cls, split: str, seed: int) -> EpisodeSeeds:
        """Those of the world with this index in a split.

        Raises
        ------
        ValueError
            If the seed is not an integer of at least 0.
        """
        return cls(*world_seed(split, seed).spawn(len(cls._fields)))


class TeamStep(NamedTuple, Generic[BeliefT]):
    """From one belief to the next, and what each robot brought and observes."""

    belief: BeliefT
    outcomes: Sequence[StepOutcome]
    reward_terms: Sequence[dict[str, float]]
    collided_with: Sequence[str]
    """Name of what each robot collided with; empty if nothing."""
    rejected_reasons: Sequence[str]
    """Why the action of each robot was rejected; empty if it was not."""
    observations: Sequence[Observation]


def outcome_info(step: TeamStep[Any], robot: int) -> dict[str, Any]:
    """Entries of a robot's info that say what came of its step."""
    outcome = step.outcomes[robot]
    return {
        "rejected_reason": step.rejected_reasons[robot],
        "collided": bool(step.collided_with[robot]),
        "reward_terms": step.reward_terms[robot],
        "new_information": outcome.new_information,
        "distance": outcome.distance,
        "new_cells": outcome.gain.new_cells,
        "entropy_reduction": outcome.gain.entropy_reduction,
    }


def copy_action_masks(observations: Mapping[str, Observation], infos: Infos) -> None:
    """Put the action masks into the infos too, where some RL libraries expect them."""
    for agent, observation in observations.items():
        if "action_mask" in observation:
            infos[agent]["action_mask"] = observation["action_mask"].copy()
