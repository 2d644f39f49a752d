"""What is trained, and how: everything that decides the result of a training; needs no torch.

A training is a chain of *segments*. At the start of each, the environments are reset and all random
numbers come from the training's seed and the segment's number; after each, the network is validated
and a checkpoint is written. So a training resumed after a segment ends as an uninterrupted one.

All values can be written as JSON, so that a training's record, a policy's file and a worker process
can hold them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Any, Literal

from coopmap_env import evaluation
from coopmap_env.core.files import brief
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    NonNegativeInt,
    OpenUnitInterval,
    Positive,
    PositiveInt,
    Settings,
    UnitInterval,
)

if TYPE_CHECKING:  # the command line loads this module to say that an option is unknown
    from coopmap_env.envs import MappingEnv
    from coopmap_env.vector import MappingVectorEnv

EngineName = Literal["ppo", "sb3", "rllib"]
InitialPolicy = Literal["random", "rating"]
CriticInput = Literal["local", "central"]
LayerWidth = Annotated[int, Bounds(at_least=1, at_most=1 << 20)]
MAX_LAYERS = 64
"""Hidden layers of a network; each takes time to make, however narrow it is."""


@dataclass(frozen=True)
class PPOSettings(Settings):
    """Hyper-parameters of proximal policy optimisation.

    Unless a field says otherwise, a step is one action of one robot, as Stable-Baselines3 counts;
    a step of the environment holds one of each robot.
    """

    total_steps: PositiveInt = 131_072
    """Length of the training, rounded up to complete roll-outs. The last segment is shorter where
    `segment_steps` does not divide it."""
    segment_steps: PositiveInt = 16_384
    """Length of a segment (from one checkpoint to the next), rounded up to complete roll-outs."""
    critic_warmup_steps: NonNegativeInt = 0
    """Steps at the start in which only the critic learns: after a warm start the policy is better
    than the advice of an untrained critic."""
    n_envs: Annotated[int, Bounds(at_least=1, at_most=1 << 16)] = 8
    """Parallel environments: a roll-out then holds steps from 8 different worlds at a time."""
    rollout_steps: PositiveInt = 64
    """Steps of each robot between updates: four episodes of the default 16 scans."""
    batch_size: Annotated[int, Bounds(at_least=2)] = 256
    """Rows of a gradient step; should divide n_envs * n_robots * rollout_steps."""
    n_epochs: PositiveInt = 5
    """Passes over a roll-out: simulation is cheap here, so samples need not be reused often."""
    learning_rate: NonNegative = 3e-4
    """Learning rate of Adam, constant."""
    gamma: UnitInterval = 0.8
    """Discount factor: a horizon of about 5 scans. Later rewards depend on what the others have
    mapped by then, which the critic cannot predict: with 0.95, policies got worse after 60,000
    steps."""
    gae_lambda: UnitInterval = 0.95
    """Lambda of generalised advantage estimation; the usual compromise of bias and variance."""
    clip_range: Positive = 0.2
    """Clip range of the probability ratio."""
    entropy_coefficient: NonNegative = 0.0
    """Weight of the entropy bonus. Raise it if the policy converges too early, as it may among
    candidates."""
    value_coefficient: NonNegative = 0.5
    """Weight of the value loss."""
    max_gradient_norm: Positive = 0.5
    """Gradients with a larger norm are clipped to it."""
    log_std: float = -1.0
    """Initial logarithm of the standard deviation in "pose" mode, 0.37 of the reach. Farther goals
    lie mostly in unknown space at first, where they are rejected."""
    initial_policy: InitialPolicy = "random"
    """Initial network in "candidates" mode: "rating" starts at the rating-function planner."""
    critic: CriticInput = "local"
    """Input of the critic: the robot's observation, or the environment's `state` in addition
    (MAPPO, Yu et al. 2022). The input of the policy is the robot's observation in both cases."""
    image_features: LayerWidth = 64
    """Length of the map's feature vector; most parameters of the network lead to it."""
    hidden: tuple[LayerWidth, ...] = (64, 64)
    """Widths of the hidden layers of the actor and of the critic."""
    device: str = "cpu"
    """Device of torch: networks this small are no faster on a GPU."""
    threads: Annotated[int, Bounds(at_least=1, at_most=1024)] = 1
    """Threads of torch. With another number, sums round differently; small networks gain little."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.critic_warmup_steps > self.total_steps:
            raise ValueError(
                f"PPOSettings.critic_warmup_steps must be <= total_steps = {self.total_steps}, got "
                f"{self.critic_warmup_steps}"
            )
        check_cells([self.n_envs, self.rollout_steps], "PPOSettings.n_envs times rollout_steps")
        if not 1 <= len(self.hidden) <= MAX_LAYERS:
            raise ValueError(
                f"PPOSettings.hidden must have 1 to {MAX_LAYERS} layers, got {brief(self.hidden)}"
            )


@dataclass(frozen=True)
class ImitationSettings(Settings):
    """Imitation of a planner; a decision is one action of one robot."""

    episodes: Annotated[int, Bounds(at_least=2)] = 150
    """Episodes of each round. All decisions stay in memory: 10 kB each with the planar map."""
    rounds: PositiveInt = 3
    """The expert plays the first round and the network the others, so that it also learns what to
    do after its own mistakes. After each round it is fitted to the decisions of all rounds."""
    epochs: PositiveInt = 10
    """Passes over the decisions after each round."""
    batch_size: PositiveInt = 256
    """Decisions of a gradient step."""
    learning_rate: Positive = 1e-3
    """Learning rate of Adam: labels are far less noisy than the gradients of PPO."""
    max_gradient_norm: Positive = 1.0
    """Gradients with a larger norm are clipped to it."""
    held_out_fraction: OpenUnitInterval = 0.1
    """Fraction of each round's episodes, rounded up, that the network is not fitted to: they
    measure its agreement with the expert. Whole episodes, as their decisions are correlated."""

    @property
    def n_held_out_episodes(self) -> int:
        """Number of held-out episodes in each round; at least one is left to learn from."""
        return min(math.ceil(self.held_out_fraction * self.episodes), self.episodes - 1)


@dataclass(frozen=True)
class EnvConfig:
    """An environment as JSON values; called, it makes a new one of the training split."""

    name: str = "planar"
    """"planar" or "field"."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Arguments of the environment's constructor, without the split and the settings."""
    settings: Mapping[str, Any] | None = None
    """`PlanarSettings` or `FieldSettings` as `settings_to_dict` writes them; None for the default.
    """

    def __call__(self) -> MappingEnv[Any]:
        """Make an environment of the training split."""
        return self.make("train")

    def make(self, split: str) -> MappingEnv[Any]:
        """Make an environment of a split."""
        return evaluation.make_env(self.name, {**self.arguments, "split": split}, self._settings())

    def vector_env(
        self, n_envs: int, split: str = "train", **options: Any
    ) -> MappingVectorEnv[Any]:
        """Make a vector environment of a split; `options` are those of its constructor."""
        arguments = {**self.arguments, "split": split}
        return evaluation.make_vector_env(self.name, n_envs, arguments, self._settings(), **options)

    def _settings(self) -> dict[str, Any] | None:
        return None if self.settings is None else dict(self.settings)


@dataclass(frozen=True, kw_only=True)
class TrainingOptions(Settings):
    """Options of a training in any environment, for Python and for `coopmap train`."""

    seed: NonNegativeInt = 0
    """Seed of everything: worlds, exploration and networks."""
    engine: EngineName = "ppo"
    """What trains: our own loop, the fastest, Stable-Baselines3, or RLlib. The loop is that of
    `coopmap_agents.ppo`; RLlib runs on Ray, on the cluster that RAY_ADDRESS names."""
    init_from: str = ""
    """Policy whose weights to start from: a file, or the name of a pretrained one; empty for random
    weights."""
    imitate: str = ""
    """Policy to imitate first, such as rating_function; empty for none. Options are written as in
    `coopmap evaluate`. Let the critic learn alone for a while then (critic_warmup_steps)."""
    imitation: ImitationSettings = field(default_factory=ImitationSettings)
    """Settings of the imitation."""
    ppo: PPOSettings = field(default_factory=PPOSettings)
    """Settings of proximal policy optimisation."""
    validation_episodes: PositiveInt = 40
    """Episodes on validation worlds after each segment. With 40 planar ones the area under the
    coverage curve is known to 3 %."""


@dataclass(frozen=True, kw_only=True)
class TrainingConfig(TrainingOptions):
    """Everything that decides the result of a training."""

    env: EnvConfig
