"""One step of a team as data: its seeds, the motion, and what came of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Generic, NamedTuple, TypeAlias, TypeVar

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.seed_sequences import seed_states
from coopmap_env.envs.belief import Belief, Observation
from coopmap_env.envs.rewards import StepOutcome
from coopmap_env.simulation.scenes import world_seed_words

BeliefT = TypeVar("BeliefT", bound=Belief)
Infos = dict[str, dict[str, Any]]
"""Info of each agent: numbers by name, with the same names after a reset and after each step."""

InfoTypes: TypeAlias = "Mapping[str, type[bool] | type[int] | type[float]]"
"""Type of each entry of a robot's info, after a reset and after each step."""
COMMON_INFO_TYPES: InfoTypes = {
    "n_scans": int,
    "elapsed_time": float,
    "observed_fraction": float,
}
"""What is the same for all robots."""
OUTCOME_INFO_TYPES: InfoTypes = {
    "rejected_reason": int,
    "collided": bool,
    "new_information": float,
    "distance": float,
    "new_cells": int,
    "entropy_reduction": float,
}
"""What came of the step, without the reward terms; `outcome_info` fills it in, and zeros stand
there after a reset."""
REWARD_PREFIX = "reward_"
"""Before the name of a reward term, in infos."""


SCENE, START, NOISE, CANDIDATES, SEEDS, VEHICLES, STREAMS = range(7)
"""Numbers of the seeds of an episode."""


class EpisodeSeeds:
    """The seeds of an episode, one for each purpose: children of the world's, made when asked for.

    Parameters
    ----------
    split : str
    seed : int
        Index of the world in the split.

    Raises
    ------
    ValueError
        If the split is unknown or the seed is not an integer of at least 0.
    """

    def __init__(self, split: str, seed: int) -> None:
        self._words = world_seed_words(split, seed)

    @staticmethod
    def states(episodes: Sequence[EpisodeSeeds], number: int, n: int) -> NDArray[np.uint64]:
        """Words (k, n) that the seed of this number generates in each of k episodes of a split."""
        if not episodes:
            return np.empty((0, n), dtype=np.uint64)
        key = (*episodes[0]._words["spawn_key"], number)
        return seed_states([seeds.index for seeds in episodes], key, n)

    @property
    def index(self) -> int:
        """Index of the world in its split."""
        return self._words["entropy"]

    def _child(self, number: int) -> np.random.SeedSequence:
        """What `spawn` of the world's seed sequence gives as the child of this number."""
        entropy, key = self._words["entropy"], self._words["spawn_key"]
        return np.random.SeedSequence(entropy, spawn_key=(*key, number))

    @property
    def scene(self) -> np.random.SeedSequence:
        """Draws the world."""
        return self._child(SCENE)

    @property
    def start(self) -> np.random.SeedSequence:
        """Draws the start of a field team."""
        return self._child(START)

    @property
    def noise(self) -> np.random.SeedSequence:
        """Draws the noise of field scans."""
        return self._child(NOISE)

    @property
    def candidates(self) -> np.random.SeedSequence:
        """Draws the candidates of a field team."""
        return self._child(CANDIDATES)

    @property
    def seeds(self) -> np.random.SeedSequence:
        """Draws the seeds of later episodes for which none is given."""
        return self._child(SEEDS)

    @property
    def vehicles(self) -> np.random.SeedSequence:
        """Draws how true vehicles differ from their descriptions."""
        return self._child(VEHICLES)

    @property
    def streams(self) -> np.random.SeedSequence:
        """Keys of the streams from which the kernels of planar worlds draw."""
        return self._child(STREAMS)


class SeedDraws:
    """The seeds of episodes for which none is given: drawn from the last one that was given.

    Until one is given, they come from the operating system.
    """

    def __init__(self) -> None:
        self._followed: EpisodeSeeds | None = None
        self._rng: np.random.Generator | None = None  # made when first needed

    def seeds_of(self, split: str, seed: int | None) -> EpisodeSeeds:
        """Those of the next episode, by the seed that was given for it; `follow` it once it began.

        Raises
        ------
        ValueError
            If the seed is not an integer of at least 0.
        """
        if seed is not None:
            return EpisodeSeeds(split, seed)
        if self._rng is None:
            followed = self._followed
            self._rng = np.random.default_rng(None if followed is None else followed.seeds)
        return EpisodeSeeds(split, int(self._rng.integers(2**31)))

    def follow(self, seeds: EpisodeSeeds) -> None:
        """Draw from these, which were given, from now on."""
        self._followed, self._rng = seeds, None


class TeamStep(NamedTuple, Generic[BeliefT]):
    """From one belief to the next, and what each robot brought and observes."""

    belief: BeliefT
    outcomes: Sequence[StepOutcome]
    reward_terms: Sequence[dict[str, float]]
    collided: Sequence[bool]
    rejected_reasons: Sequence[int]
    """Why the action of each robot was rejected: values of `RejectedReason`."""
    observations: Sequence[Observation]


def outcome_info(step: TeamStep[Any], robot: int) -> dict[str, Any]:
    """Entries of a robot's info that say what came of its step."""
    outcome = step.outcomes[robot]
    return {
        "rejected_reason": int(step.rejected_reasons[robot]),
        "collided": bool(step.collided[robot]),
        "new_information": outcome.new_information,
        "distance": outcome.distance,
        "new_cells": outcome.gain.new_cells,
        "entropy_reduction": outcome.gain.entropy_reduction,
        **{f"{REWARD_PREFIX}{name}": term for name, term in step.reward_terms[robot].items()},
    }
