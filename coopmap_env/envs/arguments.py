"""Arguments of the environments: declared once, for constructors, commands and documentation.

A world's arguments inherit from `MappingArguments`. Its environment takes them by name or in this
order, and shows their signature; `coopmap evaluate` and the other commands have an option for each.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, ParamSpec, TypeVar, cast

from coopmap_env.core.settings import PositiveInt, Settings

Parameters = ParamSpec("Parameters")
Env = TypeVar("Env")


@dataclass(frozen=True)
class MappingArguments(Settings):
    """Arguments that all environments have."""

    n_robots: PositiveInt = 2
    """Robots in the team."""
    action_mode: Literal["pose", "candidates"] = "pose"
    """Any pose (in the field: joints of the mount), or a choice among random feasible poses; see
    `coopmap_env.envs.actions`."""
    reward: Literal["rating", "information", "coverage"] = "rating"
    """Term that is paid; see `coopmap_env.envs.rewards`. All terms are in `infos`."""
    team_reward: Literal["individual", "shared"] = "individual"
    """Each robot its own reward, or all robots the mean of the team."""
    split: Literal["train", "validation", "test"] = "train"
    """Frozen split from which seeds draw their worlds."""
    max_scans: PositiveInt = 16
    """Scans of each robot until truncation."""
    n_candidates: PositiveInt = 32
    """Number of candidates m, in "candidates" mode."""
    render_mode: Literal["rgb_array", "human"] | None = None
    """Whether `render` returns an image, or shows it in a window."""


def takes_arguments(
    arguments: Callable[Parameters, MappingArguments],
) -> Callable[[Callable[..., Env]], Callable[Parameters, Env]]:
    """Give an environment's class the signature of its arguments.

    Examples
    --------
    ``parallel_env = takes_arguments(PlanarArguments)(PlanarEnv)`` is `PlanarEnv` itself, whose
    arguments editors and type checkers now know.
    """

    def declare(constructor: Callable[..., Env]) -> Callable[Parameters, Env]:
        constructor.__signature__ = inspect.signature(arguments)  # type: ignore[attr-defined]
        return cast("Callable[Parameters, Env]", constructor)

    return declare
