"""Proximal policy optimisation with one policy for all robots, on Stable-Baselines3.

Read it from top to bottom: settings, `train`, `save` and `load`, and the `LearnedPolicy` that the
evaluation takes::

    model = train(lambda: planar_v0.parallel_env(reward="information"), PPOSettings(), seed=0)
    save(model, "ppo.zip")
    env = planar_v0.parallel_env(reward="information", split="test")
    evaluation = evaluate(env, LearnedPolicy("ppo.zip"), seeds=range(100))
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief, Observation

from . import NEEDS_RL

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from .features import RobotFeatures
from .masking import MaskedPolicy
from .vec_env import EnvFactory, SharedPolicyVecEnv, stack


@dataclass(frozen=True)
class PPOSettings:
    """Hyper-parameters; a step is one action of one robot.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    total_steps: int = 500_000
    """Rounded up to whole roll-outs."""
    n_envs: int = 8
    """Parallel environments: a roll-out then holds 8 worlds at a time, which differ."""
    rollout_steps: int = 64
    """Steps of each robot between updates: a few episodes of the default 16 scans."""
    batch_size: int = 256
    """Rows of a gradient step; should divide n_envs * n_robots * rollout_steps."""
    n_epochs: int = 5
    """Passes over a roll-out: simulation is cheap here, so data need not be squeezed."""
    learning_rate: float = 3e-4
    """Of Adam, constant."""
    gamma: float = 0.95
    """Discount: looks ahead about 20 scans, a bit more than an episode."""
    gae_lambda: float = 0.95
    """Advantage estimation; the usual compromise of bias and variance."""
    clip_range: float = 0.2
    """Of the probability ratio."""
    entropy_weight: float = 0.0
    """Raise it if the policy settles too early, as it may among candidates."""
    value_weight: float = 0.5
    """Of the value loss."""
    max_gradient_norm: float = 0.5
    """Longer gradients are cut to this length."""
    log_std: float = -1.0
    """Start of the exploration in "pose" mode, 0.37 of the reach: further goals mostly lie in
    unknown space at first, where they are refused."""
    image_features: int = 128
    """Length of the map's feature vector."""
    hidden: tuple[int, ...] = (64, 64)
    """Layers of actor and critic, each."""
    device: str = "cpu"
    """Of torch: networks this small are no faster elsewhere."""

    def __post_init__(self) -> None:
        for name in (
            "total_steps", "n_envs", "rollout_steps", "batch_size", "n_epochs", "image_features",
        ):  # fmt: skip
            if getattr(self, name) < 1:
                raise ValueError(
                    f"PPOSettings.{name} must be at least 1, got {getattr(self, name)}"
                )
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(
                    f"PPOSettings.{name} must lie in [0, 1], got {getattr(self, name)}"
                )


def train(
    env_factory: EnvFactory,
    settings: PPOSettings,
    seed: int,
    callback: BaseCallback | None = None,
) -> PPO:
    """Train a policy that all robots of a team share.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment; see `SharedPolicyVecEnv`.
    settings : PPOSettings
    seed : int
        Decides everything: worlds, exploration and networks. Stable-Baselines3 seeds the global
        generators of random, numpy and torch with it.
    callback : BaseCallback, optional
        Of Stable-Baselines3, for logs and checkpoints.

    Returns
    -------
    stable_baselines3.PPO
    """
    env = VecMonitor(SharedPolicyVecEnv(env_factory, settings.n_envs))
    try:
        model = PPO(
            MaskedPolicy,
            env,
            learning_rate=settings.learning_rate,
            n_steps=settings.rollout_steps,
            batch_size=settings.batch_size,
            n_epochs=settings.n_epochs,
            gamma=settings.gamma,
            gae_lambda=settings.gae_lambda,
            clip_range=settings.clip_range,
            ent_coef=settings.entropy_weight,
            vf_coef=settings.value_weight,
            max_grad_norm=settings.max_gradient_norm,
            policy_kwargs={
                "features_extractor_class": RobotFeatures,
                "features_extractor_kwargs": {"image_features": settings.image_features},
                "net_arch": list(settings.hidden),
                "log_std_init": settings.log_std,
            },
            seed=seed,
            device=settings.device,
        )
        return model.learn(settings.total_steps, callback)
    finally:
        env.close()


def save(model: PPO, path: str | os.PathLike[str]) -> None:
    """Write a trained model as the zip file of Stable-Baselines3."""
    model.save(os.fspath(path))


def load(path: str | os.PathLike[str], device: str = "cpu") -> PPO:
    """Read a model that `save` wrote. Such files can run code: load only what you trust."""
    return PPO.load(os.fspath(path), device=device)


class LearnedPolicy:
    """A trained model as a `Policy`: each robot does what it holds to be best, without chance.

    Parameters
    ----------
    model : PPO or path
        From `train`, or the file that `save` wrote.

    Raises
    ------
    ValueError
        If the model chooses among candidates and does not know of masks.
    """

    def __init__(self, model: PPO | str | os.PathLike[str]) -> None:
        self.model = model if isinstance(model, PPO) else load(model)
        if isinstance(self.model.action_space, spaces.Discrete) and not isinstance(
            self.model.policy, MaskedPolicy
        ):
            raise ValueError(
                "a model that chooses among candidates must have a MaskedPolicy, "
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
        learned = {name: box.shape for name, box in space.spaces.items()}
        given = {name: array.shape[1:] for name, array in rows.items()}
        if learned != given:
            raise ValueError(
                f"this policy was trained on observations {learned}, but is given {given}: use the "
                "action mode, number of robots and candidates that it was trained with"
            )
