"""Hyper-parameters of training; needs no torch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, get_args

InitialPolicy = Literal["random", "rating"]
CriticInput = Literal["local", "central"]


@dataclass(frozen=True)
class PPOSettings:
    """Of proximal policy optimisation; a step is one action of one robot.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    total_steps: int = 131_072
    """Rounded up to whole roll-outs; the last segment is cut short where it does not fit in."""
    segment_steps: int = 16_384
    """Rounded up to whole roll-outs. A training is a chain of segments: at the beginning of each,
    environments start anew and all random numbers come from the training's seed and the segment's
    number, so one that is resumed from the end of a segment goes on as if nothing had happened."""
    critic_warmup_steps: int = 0
    """The first of all steps, in which only the critic learns: after a warm start the policy is
    better than what a fresh critic could tell it."""
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
    gamma: float = 0.8
    """Discount: looks ahead about 5 scans. Rewards of later ones hang on what others have mapped by
    then, and the critic cannot tell: with 0.95 policies got worse again after 60,000 steps."""
    gae_lambda: float = 0.95
    """Advantage estimation; the usual compromise of bias and variance."""
    clip_range: float = 0.2
    """Of the probability ratio."""
    entropy_coefficient: float = 0.0
    """Raise it if the policy settles too early, as it may among candidates."""
    value_coefficient: float = 0.5
    """Of the value loss."""
    max_gradient_norm: float = 0.5
    """Longer gradients are cut to this length."""
    log_std: float = -1.0
    """Start of the exploration in "pose" mode, 0.37 of the reach: further goals mostly lie in
    unknown space at first, where they are refused."""
    initial_policy: InitialPolicy = "random"
    """Of the network in "candidates" mode: "rating" begins at the rating-function planner."""
    critic: CriticInput = "local"
    """What the critic sees: each robot's own observation, or the environment's `state` besides
    (MAPPO, Yu et al. 2022). The policy sees its own observation in either case."""
    image_features: int = 64
    """Length of the map's feature vector; most of the network's parameters lead there."""
    hidden: tuple[int, ...] = (64, 64)
    """Layers of actor and critic, each."""
    device: str = "cpu"
    """Of torch: networks this small are no faster elsewhere."""

    def __post_init__(self) -> None:
        for name in (
            "total_steps", "segment_steps", "n_envs", "rollout_steps", "n_epochs", "image_features",
        ):  # fmt: skip
            check_setting(self, name, getattr(self, name) >= 1, "be at least 1")
        check_setting(self, "batch_size", self.batch_size >= 2, "be at least 2")
        for name in ("learning_rate", "entropy_coefficient", "value_coefficient"):
            check_setting(self, name, getattr(self, name) >= 0, "be at least 0")
        for name in ("clip_range", "max_gradient_norm"):
            check_setting(self, name, getattr(self, name) > 0, "be > 0")
        within = 0 <= self.critic_warmup_steps <= self.total_steps
        check_setting(self, "critic_warmup_steps", within, "lie in [0, total_steps]")
        for name in ("gamma", "gae_lambda"):
            check_setting(self, name, 0 <= getattr(self, name) <= 1, "lie in [0, 1]")
        wide = bool(self.hidden) and min(self.hidden) >= 1
        check_setting(self, "hidden", wide, "have at least one layer, each at least 1 wide")
        for name, choices in (("initial_policy", InitialPolicy), ("critic", CriticInput)):
            words = get_args(choices)
            check_setting(self, name, getattr(self, name) in words, f"be {' or '.join(words)}")


@dataclass(frozen=True)
class ImitationSettings:
    """Of learning from a planner; a decision is one action of one robot.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    episodes: int = 150
    """Of each round. All decisions stay in memory: 10 kB each with the planar map."""
    rounds: int = 3
    """The teacher plays the first one, the model the others: so it also learns what to do where
    its own mistakes lead. Each is fitted to the decisions of all rounds so far."""
    epochs: int = 10
    """Passes over the decisions in each round."""
    batch_size: int = 256
    """Decisions of a gradient step."""
    learning_rate: float = 1e-3
    """Of Adam: labels are far less noisy than the gradients of PPO."""
    max_gradient_norm: float = 1.0
    """Longer gradients are cut to this length."""
    held_out_fraction: float = 0.1
    """Share of each round's episodes, rounded up, that nothing is fitted to: they tell how well the
    model agrees with the teacher. Whole episodes, as decisions of one are alike."""

    def __post_init__(self) -> None:
        for name, least in (("episodes", 2), ("rounds", 1), ("epochs", 1), ("batch_size", 1)):
            check_setting(self, name, getattr(self, name) >= least, f"be at least {least}")
        check_setting(
            self, "held_out_fraction", 0 < self.held_out_fraction < 1, "lie between 0 and 1"
        )
        for name in ("learning_rate", "max_gradient_norm"):
            check_setting(self, name, getattr(self, name) > 0, "be > 0")

    @property
    def n_held_out_episodes(self) -> int:
        """Of each round; at least one is left to learn from."""
        return min(math.ceil(self.held_out_fraction * self.episodes), self.episodes - 1)


def check_setting(settings: object, name: str, fits: bool, what: str) -> None:
    """Refuse a value of some settings, with its name and what it must be."""
    if not fits:
        value = getattr(settings, name)
        raise ValueError(f"{type(settings).__name__}.{name} must {what}, got {value!r}")
