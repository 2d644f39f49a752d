"""Arguments of the environments: declared once, for constructors, commands and documentation.

An environment's arguments inherit from `MappingArguments`. It takes them by name or in this order,
and shows their signature. `TaskArguments` are also options of `coopmap evaluate`, `replay` and
`train`, which inherit them; `coopmap_env.cli.environment` declares the options for arguments of a
single environment.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Annotated, Literal, ParamSpec, TypeVar, cast

from coopmap_env.core.settings import Bounds, Positive, PositiveInt, Settings

Parameters = ParamSpec("Parameters")
Env = TypeVar("Env")

ActionModeName = Literal["pose", "candidates"]
SplitName = Literal["train", "validation", "test"]
RewardName = Literal["rating", "information", "coverage", "shown"]
"""The choices of the argument `reward`: a new term is named here and in `rewards.REWARD_TERMS`, and
written by `rewards.write_reward_terms`. The tests compare the three, and the commands offer it by
themselves."""
TRUE_TERMS = ("shown",)
"""Terms that only environments have that keep what scans truly show."""


@dataclass(frozen=True)
class TaskArguments(Settings):
    """What a team has to do, in any environment; options of the commands too."""

    n_robots: Annotated[int, Bounds(at_least=1, largest=1_000)] = 2
    """Robots in the team."""
    action_mode: ActionModeName = "pose"
    """Any pose, or a choice among random feasible poses. In the field, a pose is that of the joints
    of the mount; see `coopmap_env.envs.actions`."""
    reward: RewardName = "rating"
    """Term that is paid; see `coopmap_env.envs.rewards`. All terms are in `infos`; "shown", which
    is for training only, if it is paid or with ``report_shown=True``."""
    team_reward: Literal["individual", "shared"] = "individual"
    """Each robot its own reward, or all robots the mean of the team."""
    max_scans: PositiveInt = 16
    """Scans of each robot until truncation."""
    max_time: Positive | None = None
    """Seconds until truncation, on a clock that the team shares. Each step lasts as long as the
    slowest motion and the scans. The step in which it runs out is the last one."""
    n_candidates: Annotated[int, Bounds(at_least=1, largest=65_536)] = 32
    """Number of candidates m, in "candidates" mode."""


@dataclass(frozen=True)
class MappingArguments(TaskArguments):
    """Arguments that all environments have."""

    split: SplitName = "train"
    """Frozen split from which seeds draw their worlds."""
    render_mode: Literal["rgb_array", "human"] | None = None
    """Whether `render` returns an image, or shows it in a window."""
    report_shown: bool = False
    """Whether `infos` have ``shown_fraction``, for scoring: the cells that beams without noise have
    crossed up to the first true surface, and those known at the start, as a fraction of all. With
    ``reward="shown"`` they always do."""
    max_cycles: PositiveInt | None = field(default=None, kw_only=True)
    """PettingZoo's name of ``max_scans``, which it replaces where it is given."""

    @property
    def n_scans(self) -> int:
        """Scans of each robot until truncation, by either name."""
        return self.max_scans if self.max_cycles is None else self.max_cycles

    @property
    def keeps_shown(self) -> bool:
        """Whether the environment keeps what scans truly show: to report it, or to pay for it."""
        return self.report_shown or self.reward in TRUE_TERMS


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
