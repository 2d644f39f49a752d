"""A step of a field team in parts: its random numbers, the motion, the scans, the outcome."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from coopmap_env.core.linear_algebra import total
from coopmap_env.envs.field.belief import FieldBelief
from coopmap_env.envs.field.team_state import Joints
from coopmap_env.envs.rewards import StepOutcome
from coopmap_env.envs.step_data import EpisodeSeeds
from coopmap_env.information import Ratings
from coopmap_env.mapping import ScanGain
from coopmap_env.robots import Chain
from coopmap_env.sensing import Scan


class FieldRngs(NamedTuple):
    """The random numbers of an episode, one Generator for each purpose; see `EpisodeSeeds`."""

    scene: np.random.Generator
    start: np.random.Generator
    noise: np.random.Generator
    candidates: np.random.Generator
    vehicles: np.random.Generator

    @classmethod
    def from_seeds(cls, seeds: EpisodeSeeds) -> FieldRngs:
        """New ones."""
        return cls(*(np.random.default_rng(getattr(seeds, name)) for name in cls._fields))


class TeamMoveResult(NamedTuple):
    """How the motion of the team ended."""

    poses: Any
    """Measured joints of each robot's mount."""
    collided_with: Sequence[str]
    """Name of what each robot collided with; empty if nothing."""
    duration: float
    """Seconds of the slowest motion, to its end even where a collision stopped it."""


def path_time(chain: Chain, start: Joints, path: Sequence[Joints | None]) -> float:
    """Seconds of a motion through waypoints (w, n); None stays."""
    stops = [start, *(q for q in path if q is not None)]
    return total(float(chain.motion_times(q0, q1)[0]) for q0, q1 in pairwise(stops))


class FusedScans(NamedTuple):
    """The scans of a step in the maps of the robots."""

    belief: FieldBelief
    """The belief after the scans, and after what was learned of the robots' poses."""
    scans: list[Scan]
    """Scans as they were fused, in the frame of each robot's map."""
    gains: list[ScanGain]
    """What each scan brought to its map."""


def step_outcomes(
    rated: Ratings,
    gains: Sequence[ScanGain],
    collision_costs: Sequence[float],
    newly_shown: Sequence[int],
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
            newly_shown,
            strict=True,
        )
    ]
