"""Trained models: to files and back, and as policies that the evaluation takes."""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, Observation

from . import NEEDS_RL

try:
    from stable_baselines3 import PPO
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from .candidate_scorer import ANY_LENGTH, CandidateScorer
from .vec_env import stack


def save(model: PPO, path: str | os.PathLike[str]) -> None:
    """Write a trained model as the zip file of Stable-Baselines3."""
    model.save(os.fspath(path))


def load(path: str | os.PathLike[str], device: str = "cpu") -> PPO:
    """Read a model that `save` wrote. Such files can run code: load only what you trust."""
    return PPO.load(os.fspath(path), device=device)


class LearnedPolicy:
    """A trained model as a `Policy`: each robot does what it holds to be best, without chance.

    A `CandidateScorer` decides among any number of candidates, and beside any number of teammates
    if it was trained with some.

    Parameters
    ----------
    model : PPO or path
        From `train`, or the file that `save` wrote.

    Raises
    ------
    ValueError
        If the model chooses among candidates and is no `CandidateScorer`.
    """

    def __init__(self, model: PPO | str | os.PathLike[str]) -> None:
        self.model = model if isinstance(model, PPO) else load(model)
        if isinstance(self.model.action_space, spaces.Discrete) and not isinstance(
            self.model.policy, CandidateScorer
        ):
            raise ValueError(
                "a model that chooses among candidates must have a CandidateScorer, "
                f"got {type(self.model.policy).__name__}"
            )

    def reset(self, rng: np.random.Generator) -> None:
        """Nothing to forget and nothing to draw."""

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """One action for each robot, from its own observation.

        Raises
        ------
        ValueError
            If the observations are not of the shape that the model was trained on.
        """
        rows = stack(observations[agent] for agent in belief.agents)
        self._check(rows)
        actions, _ = self.model.predict(rows, deterministic=True)
        return dict(zip(belief.agents, actions, strict=True))

    def _check(self, rows: Mapping[str, NDArray[Any]]) -> None:
        space = self.model.observation_space
        assert isinstance(space, spaces.Dict)
        free = ANY_LENGTH if isinstance(self.model.policy, CandidateScorer) else ()
        learned = {name: _shape(box.shape, name in free) for name, box in space.spaces.items()}
        given = {name: _shape(rows[name].shape[1:], name in free) for name in rows}
        if learned != given:
            raise ValueError(
                f"this policy was trained on observations {learned}, but is given {given}: use the "
                "action mode, number of robots and candidates that it was trained with"
            )


def _shape(shape: tuple[int, ...] | None, any_length: bool) -> tuple[int | str, ...]:
    assert shape is not None
    return ("any", *shape[1:]) if any_length else shape
