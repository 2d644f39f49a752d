"""A benchmark family: a task that does not change, on worlds that do not change."""

from __future__ import annotations

import json
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

from coopmap_env.core.settings import settings_to_dict
from coopmap_env.envs import MappingEnv, TeamEnv
from coopmap_env.evaluation import EnvSpec, get_env_spec
from coopmap_env.vector import MappingVectorEnv

FREE_ARGUMENTS = (
    "action_mode", "n_candidates", "reward", "team_reward", "render_mode", "report_shown",
)  # fmt: skip
"""What a policy chooses: how it acts, and what it learns from. All else belongs to the family."""
VECTOR_ARGUMENTS = ("rows", "autoreset_mode", "double_buffer", "with_state", "num_workers")
"""Likewise, of vector environments."""


@dataclass(frozen=True, eq=False)
class Family:
    """A scene, a team and a budget under one name.

    Its worlds are those of the seeds 0, 1, ... of a split (`worlds.N_WORLDS` of them); a training
    may draw any other seeds of its split too.
    """

    name: str
    env_name: Literal["planar", "field"]
    summary: str
    """What makes it hard, in one sentence."""
    scene: Mapping[str, Any]
    """Name of the scene, and those of its fields that are not the default, as JSON values."""
    budget: Mapping[str, Any]
    """``n_robots``, ``max_scans`` and, where time ends episodes, ``max_time``."""
    settings: Any
    """`PlanarSettings` or `FieldSettings`."""
    arguments: Mapping[str, Any] = field(default_factory=dict)
    """Other arguments of the environment."""

    def __post_init__(self) -> None:
        for name in ("scene", "budget", "arguments"):
            object.__setattr__(self, name, MappingProxyType(deepcopy(dict(getattr(self, name)))))

    @property
    def env_id(self) -> str:
        """The id in both registries."""
        return f"coopmap/{self.env_name.capitalize()}-{self.name}-v1"

    @property
    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment that belong to the family, without settings, as JSON."""
        return deepcopy({"scene": dict(self.scene), **self.budget, **self.arguments})

    @property
    def definition(self) -> dict[str, Any]:
        """All that decides its worlds and its rules, as JSON values."""
        values = {
            "env": self.env_name,
            "arguments": self.env_kwargs,
            "settings": settings_to_dict(self.settings),
        }
        as_json: dict[str, Any] = json.loads(json.dumps(values))
        return as_json

    def make(self, split: str = "train", **options: Any) -> MappingEnv[Any]:
        """Make the parallel environment of a split.

        Parameters
        ----------
        split : {"train", "validation", "test"}
        **options
            Any of `FREE_ARGUMENTS`.

        Raises
        ------
        ValueError
            If an option belongs to the family, or its value is not accepted.
        ImportError
            With the pip command, if an extra is missing.
        """
        return self._spec.make(**self._arguments(split, options))

    def make_team(self, split: str = "train", **options: Any) -> TeamEnv:
        """Make the environment of one controller for the whole team; see `make`."""
        return self._spec.make_team(**self._arguments(split, options))

    def make_vector(
        self, n_envs: int, split: str = "train", **options: Any
    ) -> MappingVectorEnv[Any]:
        """Make a vector environment; see `make`. `VECTOR_ARGUMENTS` are options too."""
        arguments = self._arguments(split, options, (*FREE_ARGUMENTS, *VECTOR_ARGUMENTS))
        return self._spec.make_vector(n_envs, **arguments)

    @property
    def _spec(self) -> EnvSpec:
        return get_env_spec(self.env_name)

    def _arguments(
        self, split: str, options: Mapping[str, Any], free: tuple[str, ...] = FREE_ARGUMENTS
    ) -> dict[str, Any]:
        for name in options:
            if name not in free:
                raise ValueError(
                    f"the family {self.name!r} has its own {name!r}; free are {', '.join(free)}"
                )
        return {**self.env_kwargs, "settings": self.settings, "split": split, **options}
