"""One step of a team as data: random generators, the motion, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from coopmap_env.envs.belief import Belief, Observation
from coopmap_env.envs.rewards import REWARD_TERMS, StepOutcome
from coopmap_env.information import Ratings
from coopmap_env.mapping import ScanGain
from coopmap_env.sensing import Scan

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


class EpisodeRngs(NamedTuple):
    """The random numbers of an episode, one Generator for each purpose."""

    scene: np.random.Generator
    start: np.random.Generator
    noise: np.random.Generator
    candidates: np.random.Generator
    seeds: np.random.Generator
    """Draws the seeds of later resets without a seed."""
    vehicles: np.random.Generator
    """Draws how true vehicles differ from their descriptions."""


class TeamMoveResult(NamedTuple):
    """How the motion of the team ended."""

    poses: Any
    """Measured pose of each robot: lattice ids or joints."""
    collided_with: Sequence[str]
    """Name of what each robot collided with; empty if nothing."""
    collision_cells: Sequence[int] = ()
    """Cells of the map that the collisions show to be occupied."""


class FusedScans(NamedTuple, Generic[BeliefT]):
    """The scans of a step in the maps of the robots."""

    belief: BeliefT
    """The belief after the scans, and after what was learned of the robots' poses."""
    scans: list[Scan]
    """Scans as they were fused, in the frame of each robot's map."""
    gains: list[ScanGain]
    """What each scan brought to its map."""


class Transition(NamedTuple, Generic[BeliefT]):
    """From one belief to the next."""

    belief: BeliefT
    scans: list[Scan]
    outcomes: list[StepOutcome]
    """Outcome of the step for each robot."""
    collided_with: Sequence[str]
    """Name of what each robot collided with; empty if nothing."""


def step_outcomes(
    rated: Ratings, gains: Sequence[ScanGain], collision_costs: Sequence[float]
) -> list[StepOutcome]:
    """The outcome of each robot, from the ratings of the executed poses and its scan's gain."""
    return [
        StepOutcome(*values)
        for values in zip(
            rated.new_information.tolist(),
            rated.distance.tolist(),
            rated.motion_cost.tolist(),
            rated.rating.tolist(),
            gains,
            collision_costs,
            strict=True,
        )
    ]


def outcome_info(
    transition: Transition[Any], robot: int, terms: dict[str, float], rejected_reason: str
) -> dict[str, Any]:
    """Entries of a robot's info that say what came of its step."""
    outcome = transition.outcomes[robot]
    return {
        "rejected_reason": rejected_reason,
        "collided": bool(transition.collided_with[robot]),
        "reward_terms": terms,
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
