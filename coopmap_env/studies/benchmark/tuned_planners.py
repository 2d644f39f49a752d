"""The record of the planners' sweep on training worlds: which planner is strongest by which score.

`tuning` writes it, with the constants of the rating function that it was played with.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coopmap_env.core.files import FileError, read_json
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.information import FieldRatingSettings, PlanarRatingSettings
from coopmap_env.studies.benchmark.methods import (
    EnvKwargs,
    Opponent,
    planner_method,
    verdict_scores,
)

RECORD = Path(__file__).with_name("tuned_planners.json")
"""The record of the repository."""


@dataclass(frozen=True)
class TunedCase:
    """All planners of one environment with one kind of actions, on training worlds."""

    env_name: str
    env_kwargs: EnvKwargs
    """What the actions are: candidates, or any pose."""
    n_worlds: int
    families: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]
    """By family, planner's spec and score: mean with its 95 % interval."""

    rating: Mapping[str, Any]
    """Constants of the environment's rating function, on which the reward depends."""

    @property
    def is_current(self) -> bool:
        """Whether the constants are the defaults, so that the scores can be compared."""
        return dict(self.rating) == rating_constants(self.env_name)

    def mean(self, family: str, spec: str, score: str) -> float:
        """Mean score of one planner."""
        return self.families[family][spec][score]["estimate"]

    def strongest(self, family: str, score: str) -> str:
        """Spec of the family's planner with the largest mean score."""
        return max(self.families[family], key=lambda spec: self.mean(family, spec, score))

    def opponents(self) -> tuple[Opponent, ...]:
        """The strongest planner of each family for each score of the verdicts."""
        return tuple(
            Opponent(score, planner_method(spec, self.env_kwargs), self.mean(family, spec, score))
            for score in verdict_scores(self.env_name)
            for family in self.families
            for spec in [self.strongest(family, score)]
        )


def read_record(path: Path = RECORD) -> tuple[TunedCase, ...]:
    """The cases of a record.

    Raises
    ------
    FileError
        If the file is missing or is no such record.
    """
    try:
        return tuple(_case(values) for values in read_json(path)["cases"])
    except (KeyError, TypeError, AttributeError) as error:
        raise FileError(f"{path}: expected a record of tuned planners: {error!r}") from error


def _case(values: Mapping[str, Any]) -> TunedCase:
    case = TunedCase(
        values["env_name"],
        values["env_kwargs"],
        values["n_worlds"],
        values["families"],
        values["rating"],
    )
    case.opponents()  # reads every mean that a plan needs
    return case


def rating_constants(env_name: str) -> dict[str, Any]:
    """Default constants of an environment's rating function, as JSON values."""
    kinds = {"planar": PlanarRatingSettings, "field": FieldRatingSettings}
    return settings_to_dict(kinds[env_name]())


def record_notes(cases: Sequence[TunedCase]) -> list[str]:
    """A sentence for each environment whose planners were tuned with other constants than now."""
    stale = sorted({case.env_name for case in cases if not case.is_current})
    return [
        f"{name}: the opponents were tuned with other constants of the rating function than those "
        "of the environment; `make planners` tunes them again"
        for name in stale
    ]


def find_case(cases: Sequence[TunedCase], env_name: str, env_kwargs: EnvKwargs) -> TunedCase | None:
    """The case of an environment and its actions, if there is one."""
    same = (case for case in cases if (case.env_name, case.env_kwargs) == (env_name, env_kwargs))
    return next(same, None)
