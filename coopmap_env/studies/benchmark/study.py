"""The comparison of learned policies and planners: who plays where, and what came of it.

Everybody meets the same worlds of the test split, whatever the action mode: the seed decides world
and starts. `evaluation.policy_entries` says who and where, `evaluation.run_statistics` what the
intervals are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.version import __version__
from coopmap_env.evaluation.comparison import BOOTSTRAP_SEED, Evaluation, compare
from coopmap_env.evaluation.policy import make_policy
from coopmap_env.evaluation.statistics import training_runs as run_statistics
from coopmap_env.evaluation.statistics.bootstrap import Interval
from coopmap_env.studies.benchmark.entries import LEARNED, Condition, Entry, Plan

Array = NDArray[np.float64]

SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "log_loss",
    "motion_cost",
    "surface",
    "surface_auc",
    "f_score",
    "planning_ms",
)
"""Columns that are summed up, those of them that the world has."""
CURVES = {"planar": "viewed", "field": "surface"}
"""What is drawn against scans."""
AREAS = {"planar": ("coverage_auc",), "field": ("surface_auc", "coverage_auc")}
"""Areas under curves; the first is that of the drawn one."""
REWARD = "reward"
"""The planner's own objective: verdicts are about it and about the areas."""
N_THRESHOLDS = 61
"""Of a performance profile."""


@dataclass(frozen=True)
class Outcome:
    """What an entry did under a condition."""

    entry: Entry
    runs: tuple[Evaluation, ...]
    """One for each of its specs, on the same worlds."""

    @cached_property
    def scores(self) -> dict[str, Array]:
        """Scores by column, each of shape (n_runs, n_worlds)."""
        tables = [run.table for run in self.runs]
        return {
            name: np.array([table[name] for table in tables])
            for name in SCORES
            if name in tables[0]
        }

    def curves(self, name: str) -> Array:
        """Curves, shape (n_runs, n_worlds, n_scans + 1)."""
        return np.array([run.curves[name] for run in self.runs])


@dataclass(frozen=True)
class ConditionResult:
    """All entries under one condition."""

    condition: Condition
    outcomes: tuple[Outcome, ...]

    def of(self, entry: Entry) -> Outcome:
        """What that entry did."""
        return next(outcome for outcome in self.outcomes if outcome.entry == entry)


@dataclass(frozen=True)
class PolicyStudy:
    """All results."""

    main: tuple[ConditionResult, ...]
    elsewhere: tuple[ConditionResult, ...]


def run(store: Path, plan: Plan, workers: int, say: Callable[[str], None]) -> PolicyStudy:
    """Play everything; finished episodes are kept in `store` and not played again.

    Raises
    ------
    ValueError
        If a policy or an argument of an environment is not accepted.
    ImportError
        With the pip command, if an extra is missing.
    """
    entries = (entry for part in (*plan.main, *plan.elsewhere) for entry in part.entries)
    for spec in dict.fromkeys(spec for entry in entries for spec in entry.specs):
        make_policy(spec)  # a model that is missing is not to be found out after half an hour
    return PolicyStudy(
        tuple(run_condition(store, condition, workers, say) for condition in plan.main),
        tuple(run_condition(store, condition, workers, say) for condition in plan.elsewhere),
    )


def run_condition(
    store: Path, condition: Condition, workers: int, say: Callable[[str], None]
) -> ConditionResult:
    """Let all entries of a condition play."""
    say(f"{condition.world}, {condition.label}: {condition.n_worlds} test worlds")
    groups: dict[str, list[Entry]] = {}
    for entry in condition.entries:  # those of one environment share its workers
        groups.setdefault(repr(sorted(entry.arguments.items())), []).append(entry)
    runs: dict[str, tuple[Evaluation, ...]] = {}
    for entries in groups.values():
        found = compare(
            [spec for entry in entries for spec in entry.specs],
            range(condition.n_worlds),
            {**condition.arguments, **entries[0].arguments},
            store,
            workers=workers,
            world=condition.world,
        )
        for entry in entries:
            runs[entry.label] = tuple(found[spec] for spec in entry.specs)
    return ConditionResult(
        condition, tuple(Outcome(entry, runs[entry.label]) for entry in condition.entries)
    )


def summary(study: PolicyStudy) -> dict[str, Any]:
    """Everything that was found, as JSON values; intervals are 95 %."""
    main = [condition_summary(result) for result in study.main]
    return {
        "version": __version__,
        "verdicts": [verdict for found in main for verdict in verdicts(found)],
        "main": main,
        "elsewhere": [condition_summary(result) for result in study.elsewhere],
    }


def condition_summary(result: ConditionResult) -> dict[str, Any]:
    """Scores, curves, profiles and comparisons of all entries under one condition."""
    condition = result.condition
    area = AREAS[condition.world][0]
    every = np.concatenate([outcome.scores[area].ravel() for outcome in result.outcomes])
    thresholds = np.linspace(every.min(), every.max(), N_THRESHOLDS)
    return {
        "label": condition.label,
        "world": condition.world,
        "worlds": condition.n_worlds,
        "arguments": dict(condition.arguments),
        "areas": list(AREAS[condition.world]),
        "thresholds": thresholds.tolist(),
        "entries": {
            outcome.entry.label: _entry_summary(outcome, result, thresholds)
            for outcome in result.outcomes
        },
    }


def _entry_summary(outcome: Outcome, result: ConditionResult, thresholds: Array) -> dict[str, Any]:
    entry, condition = outcome.entry, result.condition
    area, curve = AREAS[condition.world][0], CURVES[condition.world]
    baseline = condition.baseline_of(entry)
    return {
        "family": entry.family,
        "pictured": entry.pictured,
        "policies": list(entry.specs),
        "arguments": dict(entry.arguments),
        "scores": {name: _score_summary(scores) for name, scores in outcome.scores.items()},
        "curve": run_statistics.mean_curve(outcome.curves(curve), _rng()).as_dict(),
        "profile": run_statistics.performance_profile(
            outcome.scores[area], thresholds, _rng()
        ).as_dict(),
        "baseline": baseline.label if baseline else None,
        "against": {
            rival.label: comparison_summary(outcome, result.of(rival), AREAS[condition.world])
            for rival in condition.rivals_of(entry)
        },
    }


def _score_summary(scores: Array) -> dict[str, Any]:
    return {
        "mean": run_statistics.mean(scores, _rng()).as_dict(),
        "interquartile_mean": run_statistics.interquartile_mean(scores, _rng()).as_dict(),
        "runs": scores.mean(axis=1).tolist(),
    }


def comparison_summary(ours: Outcome, theirs: Outcome, areas: tuple[str, ...]) -> dict[str, Any]:
    """One entry against another on the same worlds."""
    judged = (*areas, REWARD)
    return {
        "chooses_alike": ours.entry.arguments == theirs.entry.arguments,
        "difference": {
            name: run_statistics.difference(scores, theirs.scores[name]).as_dict()
            for name, scores in ours.scores.items()
            if name != "planning_ms"
        },
        "difference_of_runs": {
            name: (ours.scores[name].mean(axis=1) - theirs.scores[name].mean()).tolist()
            for name in judged
        },
        "ratio": {
            area: run_statistics.ratio(ours.scores[area], theirs.scores[area], _rng()).as_dict()
            for area in areas
        },
        "probability_of_improvement": {
            name: run_statistics.probability_of_improvement(
                ours.scores[name], theirs.scores[name], _rng()
            ).as_dict()
            for name in judged
        },
    }


def verdicts(found: dict[str, Any]) -> list[dict[str, Any]]:
    """Learned policies less planners, in areas and reward, and where the intervals lie.

    Each learned entry is held against its baseline, the planner that does best on the same
    candidates by that score, and the reference planner, as far as the condition has them.
    """
    return [
        {
            "world": found["world"],
            "score": score,
            "learned": label,
            "planner": rival,
            "difference": entry["against"][rival]["difference"][score],
            "runs": entry["against"][rival]["difference_of_runs"][score],
            "verdict": where_it_lies(Interval(**entry["against"][rival]["difference"][score])),
        }
        for label, entry in found["entries"].items()
        if entry["family"] == LEARNED
        for score in (*found["areas"], REWARD)
        for rival in judged_rivals(found["entries"], entry, score)
    ]


def where_it_lies(interval: Interval) -> str:
    """What an interval of a difference says."""
    if interval.low > 0:
        return "above zero"
    return "below zero" if interval.high < 0 else "zero lies within"


def judged_rivals(entries: dict[str, Any], entry: dict[str, Any], score: str) -> list[str]:
    """Baseline, the planner that does best choosing alike, and those that choose any pose."""
    against = entry["against"]
    same = [name for name, values in against.items() if values["chooses_alike"]]

    def mean(name: str) -> float:
        return float(entries[name]["scores"][score]["mean"]["estimate"])

    best = max(same, key=mean, default=None)
    wanted = [entry["baseline"], best, *(name for name in against if name not in same)]
    return [name for name in dict.fromkeys(wanted) if name is not None]


def _rng() -> np.random.Generator:
    """The same draws of worlds for every statistic."""
    return np.random.default_rng(BOOTSTRAP_SEED)
