"""Proximal policy optimisation with one policy for all robots, on Stable-Baselines3.

Read it from top to bottom: settings, `make_model`, `train`; `save`, `load` and the `LearnedPolicy`
that the evaluation takes are in `coopmap_agents.learned_policy` and can be had from here too::

    model = train(lambda: planar_v0.parallel_env(reward="information"), PPOSettings(), seed=0)
    save(model, "ppo.zip")
    env = planar_v0.parallel_env(reward="information", split="test")
    evaluation = evaluate(env, LearnedPolicy("ppo.zip"), seeds=range(100))

In "candidates" mode the policy is a `CandidateScorer`, in "pose" mode a Gaussian around a network's
output. `coopmap_agents.imitation` makes a model that has learned from a planner, to go on from.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from gymnasium import spaces

from . import NEEDS_RL

try:
    from stable_baselines3 import PPO
    from stable_baselines3.common.callbacks import BaseCallback
    from stable_baselines3.common.vec_env import VecMonitor
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from .candidate_scorer import CandidateScorer, Initial
from .features import RobotFeatures
from .learned_policy import LearnedPolicy, load, save
from .vec_env import EnvFactory, SharedPolicyVecEnv

__all__ = ["LearnedPolicy", "PPOSettings", "load", "make_model", "save", "train"]

CRITIC = ("network.value.", "mlp_extractor.value_net.", "value_net.")
"""Beginnings of the names of the critic's own parameters, in either mode."""


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
    critic_steps: int = 0
    """The first of them, in which only the critic learns: after a warm start the policy is better
    than what a fresh critic could tell it."""
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
    initial: Initial = "random"
    """Of the network in "candidates" mode: "rating" begins at the rating-function planner."""
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
        if not 0 <= self.critic_steps <= self.total_steps:
            raise ValueError(
                f"PPOSettings.critic_steps must lie in [0, total_steps], got {self.critic_steps}"
            )
        for name in ("gamma", "gae_lambda"):
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(
                    f"PPOSettings.{name} must lie in [0, 1], got {getattr(self, name)}"
                )


def make_model(env_factory: EnvFactory, settings: PPOSettings, seed: int) -> PPO:
    """Make an untrained model with its environments.

    Parameters
    ----------
    env_factory : callable
        Makes a new parallel environment; see `SharedPolicyVecEnv`.
    settings : PPOSettings
    seed : int
        Decides everything: worlds, exploration and networks. Stable-Baselines3 seeds the global
        generators of random, numpy and torch with it.

    Raises
    ------
    ValueError
        If robots choose among candidates that they do not observe.
    """
    env = VecMonitor(SharedPolicyVecEnv(env_factory, settings.n_envs))
    try:
        policy, options = _policy(env.action_space, settings)
        return PPO(
            policy,
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
            policy_kwargs=options,
            seed=seed,
            device=settings.device,
        )
    except BaseException:
        env.close()
        raise


def _policy(
    action_space: spaces.Space[Any], settings: PPOSettings
) -> tuple[str | type[CandidateScorer], dict[str, Any]]:
    """Policy and its options for an action mode."""
    options: dict[str, Any] = {
        "net_arch": list(settings.hidden),
        "features_extractor_kwargs": {"image_features": settings.image_features},
    }
    if isinstance(action_space, spaces.Discrete):
        return CandidateScorer, {**options, "initial": settings.initial}
    own = {"features_extractor_class": RobotFeatures, "log_std_init": settings.log_std}
    return "MultiInputPolicy", {**options, **own}


def train(
    env_factory: EnvFactory,
    settings: PPOSettings,
    seed: int,
    callback: BaseCallback | None = None,
    warm_start: PPO | None = None,
) -> PPO:
    """Train a policy that all robots of a team share.

    Parameters
    ----------
    env_factory, settings, seed
        As in `make_model`.
    callback : BaseCallback, optional
        Of Stable-Baselines3, for logs and checkpoints.
    warm_start : PPO, optional
        A model whose network to begin with, made with the same settings of the network; it stays as
        it is.

    Returns
    -------
    stable_baselines3.PPO

    Raises
    ------
    ValueError
        As `make_model`, or if the network of `warm_start` is another one.
    """
    model = make_model(env_factory, settings, seed)
    try:
        if warm_start is not None:
            _copy_network(warm_start, model)
        if settings.critic_steps:
            _set_actor_learns(model, False)
            model.learn(settings.critic_steps, callback)
            _set_actor_learns(model, True)
            if model.num_timesteps < settings.critic_steps:
                return model  # the callback has ended it
        left = max(settings.total_steps - model.num_timesteps, 0)
        return model.learn(left, callback, reset_num_timesteps=model.num_timesteps == 0)
    finally:
        assert model.env is not None
        model.env.close()


def _copy_network(source: PPO, target: PPO) -> None:
    given, own = source.policy.state_dict(), target.policy.state_dict()
    shapes, needed = ({k: tuple(v.shape) for k, v in state.items()} for state in (given, own))
    if shapes != needed:
        other = sorted(k for k in shapes | needed if shapes.get(k) != needed.get(k))
        raise ValueError(
            f"warm_start has another network than these settings and environments make: {other[0]} "
            f"has the shape {shapes.get(other[0])}, not {needed.get(other[0])}"
        )
    target.policy.load_state_dict(given)


def _set_actor_learns(model: PPO, learns: bool) -> None:
    for name, parameter in model.policy.named_parameters():
        if not name.startswith(CRITIC):
            parameter.requires_grad_(learns)
