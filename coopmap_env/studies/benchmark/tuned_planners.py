"""The record of the planners' sweep on training worlds: which planner is strongest by which score.

`tuning` writes it, with the settings of the environment that it was played with.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coopmap_env.core.files import FileError, brief, read_json
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.evaluation import get_env_spec, make_policy
from coopmap_env.studies.benchmark.equal_motion import concave_hull
from coopmap_env.studies.benchmark.methods import (
    ALL_PLANNERS,
    AREAS,
    MOTION,
    EnvKwargs,
    MotionLine,
    Opponent,
    planner_method,
    verdict_scores,
)

RECORD = Path(__file__).with_name("tuned_planners.json")
"""The record of the repository."""
SPLIT = "train"
"""Split of the worlds of a record."""


@dataclass(frozen=True)
class TunedCase:
    """All planners of one environment with one kind of actions, on training worlds."""

    env_name: str
    env_kwargs: EnvKwargs
    """What the actions are: candidates, or any pose."""
    n_worlds: int
    families: Mapping[str, Mapping[str, Mapping[str, Mapping[str, float]]]]
    """By family, planner's spec and score (or motion): mean with its 95 % interval."""
    settings: Mapping[str, Any]
    """Of the environment, as JSON values: camera, beam model, rating function and all others."""

    @property
    def is_current(self) -> bool:
        """Whether the settings are the defaults, so that the scores can be compared."""
        return dict(self.settings) == default_settings(self.env_name)

    def mean(self, family: str, spec: str, score: str) -> float:
        """Mean score of one planner."""
        return self.families[family][spec][score]["estimate"]

    def strongest(self, family: str, score: str) -> str:
        """Spec of the family's planner with the largest mean score."""
        return max(self.families[family], key=lambda spec: self.mean(family, spec, score))

    def opponents(self) -> tuple[Opponent, ...]:
        """The strongest planner of each family for each score of the verdicts."""
        return tuple(
            Opponent(
                score,
                planner_method(spec, self.env_kwargs),
                self.mean(family, spec, score),
                self.n_worlds,
            )
            for score in verdict_scores(self.env_name)
            for family in self.families
            for spec in [self.strongest(family, score)]
        )

    def lines(self) -> tuple[MotionLine, ...]:
        """The opponents at equal motion for each score: of all families together, and of each."""
        by_family = {
            family: [(family, spec) for spec in rows] for family, rows in self.families.items()
        }
        everyone = [member for members in by_family.values() for member in members]
        return tuple(
            self._line(score, members, is_everyone=members is everyone)
            for score in verdict_scores(self.env_name)
            for members in (everyone, *by_family.values())
        )

    def _line(self, score: str, members: list[tuple[str, str]], is_everyone: bool) -> MotionLine:
        hull = concave_hull(
            [self.mean(*member, score) for member in members],
            [self.mean(*member, MOTION) for member in members],
        )
        methods = tuple(planner_method(members[row][1], self.env_kwargs) for row in hull)
        family = ALL_PLANNERS if is_everyone else methods[0].family
        return MotionLine(family, score, methods, self.n_worlds)


def default_settings(env_name: str) -> dict[str, Any]:
    """Default settings of an environment, as JSON values."""
    settings = get_env_spec(env_name).settings_class()
    values: dict[str, Any] = json.loads(json.dumps(settings_to_dict(settings)))
    return values


def record_notes(cases: Sequence[TunedCase]) -> list[str]:
    """A sentence for each environment whose planners were tuned with other settings than now."""
    stale = sorted({case.env_name for case in cases if not case.is_current})
    return [
        f"{name}: the opponents were tuned with other constants than the environment has now; "
        "`make planners` tunes them again"
        for name in stale
    ]


def find_case(cases: Sequence[TunedCase], env_name: str, env_kwargs: EnvKwargs) -> TunedCase | None:
    """The case of an environment and its actions, if there is one."""
    same = (case for case in cases if (case.env_name, case.env_kwargs) == (env_name, env_kwargs))
    return next(same, None)


def read_record(path: Path = RECORD) -> tuple[TunedCase, ...]:
    """The cases of a record.

    Raises
    ------
    FileError
        With the path and the value, if the file is missing or is no such record.
    """
    values = read_json(path)
    try:
        _check("split", values["split"], values["split"] == SPLIT, repr(SPLIT))
        _check_filled("cases", values["cases"], list)
        return tuple(_case(case) for case in values["cases"])
    except (KeyError, TypeError, AttributeError) as error:
        raise FileError(f"{path}: expected a record of tuned planners: {error!r}") from error
    except ValueError as error:
        raise FileError(f"{path}: {error}") from error


def _case(values: Mapping[str, Any]) -> TunedCase:
    env_name, n_worlds = values["env_name"], values["n_worlds"]
    _check("env_name", env_name, env_name in AREAS, " or ".join(AREAS))
    _check("n_worlds", n_worlds, type(n_worlds) is int and n_worlds > 0, "a positive integer")
    for key in ("env_kwargs", "settings", "families"):
        _check_filled(key, values[key], dict)
    for family, rows in values["families"].items():
        _check_filled(f"family {family}", rows, dict)
        for spec, row in rows.items():
            make_policy(spec)
            for score in (*verdict_scores(env_name), MOTION):
                mean = row[score]["estimate"]
                is_number = isinstance(mean, float | int) and math.isfinite(mean)
                _check(f"mean {score} of {spec}", mean, is_number, "a number")
    return TunedCase(
        env_name, values["env_kwargs"], n_worlds, values["families"], values["settings"]
    )


def _check(name: str, value: Any, is_good: bool, expected: str) -> None:
    if not is_good:
        raise ValueError(f"{name} must be {expected}, got {brief(value)}")


def _check_filled(name: str, value: Any, kind: type[list[Any]] | type[dict[str, Any]]) -> None:
    noun = "list" if kind is list else "mapping"
    _check(name, value, isinstance(value, kind) and bool(value), f"a {noun} that is not empty")
