"""What is trained, and how: all that decides the result of a training; needs no torch.

Inside are JSON values only, so that a training's record, a policy's file and a worker process can
hold them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from coopmap_agents.settings import ImitationSettings, PPOSettings, check_setting

from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.evaluation.worlds import make_env

EngineName = Literal["sb3", "rllib"]


@dataclass(frozen=True)
class EnvConfig:
    """An environment of the training split; called, it makes a new one."""

    name: str = "planar"
    """"planar" or "field"."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Of the environment's constructor, but for the split and the settings."""
    settings: Mapping[str, Any] | None = None
    """`PlanarSettings` or `FieldSettings` as `settings_to_dict` writes them; by default its own."""

    def __call__(self) -> MappingEnv[Any]:
        """Make an environment whose worlds are those of the training split."""
        return self.make("train")

    def make(self, split: str) -> MappingEnv[Any]:
        """Make an environment whose worlds are those of a split."""
        settings = None if self.settings is None else dict(self.settings)
        return make_env(self.name, {**self.arguments, "split": split}, settings)


@dataclass(frozen=True)
class TrainingConfig:
    """All that decides the result of a training."""

    env: EnvConfig
    ppo: PPOSettings
    seed: int
    engine: EngineName = "sb3"
    init_from: str = ""
    """File or shipped name of a policy whose weights to begin with; empty for fresh ones."""
    expert: str = ""
    """Spec of a policy to imitate before; empty for none."""
    imitation: ImitationSettings = field(default_factory=ImitationSettings)
    validation_episodes: int = 40
    """Validation worlds after each segment: with 40 in the plane the area under the coverage curve
    is known to 3 % of itself."""

    def __post_init__(self) -> None:
        check_setting(self, "seed", self.seed >= 0, "be at least 0")
        names = get_args(EngineName)
        check_setting(self, "engine", self.engine in names, f"be {' or '.join(names)}")
        check_setting(self, "validation_episodes", self.validation_episodes >= 1, "be at least 1")
