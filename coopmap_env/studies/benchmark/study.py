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
from coopmap_env.studies.benchmark.methods import LEARNED, BenchmarkPlan, Condition, Method

Array = NDArray[np.float64]

SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "log_loss",
    "motion_cost",
    "surface_coverage",
    "surface_coverage_auc",
    "f_score",
    "planning_time_ms",
)
"""Columns that are summed up, those of them that the world has."""
CURVES = {"planar": "coverage", "field": "surface_coverage"}
"""What is drawn against scans."""
AREAS = {"planar": ("coverage_auc",), "field": ("surface_coverage_auc", "coverage_auc")}
"""Areas under curves; the first is that of the drawn one."""
REWARD = "reward"
"""The planner's own objective: verdicts are about it and about the areas."""
N_THRESHOLDS = 61
"""Of a performance profile."""


@dataclass(frozen=True)
class MethodResult:
    """What an entry did under a condition."""

    method: Method
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
    method_results: tuple[MethodResult, ...]

    def result_for(self, method: Method) -> MethodResult:
        """What that entry did."""
        return next(
            method_result for method_result in self.method_results if method_result.method == method
        )


@dataclass(frozen=True)
class BenchmarkStudy:
    """All results."""

    main: tuple[ConditionResult, ...]
    generalization: tuple[ConditionResult, ...]


def run(
    store: Path, plan: BenchmarkPlan, workers: int, log: Callable[[str], None]
) -> BenchmarkStudy:
    """Play everything; finished episodes are kept in `store` and not played again.

    Raises
    ------
    ValueError
        If a policy or an argument of an environment is not accepted.
    ImportError
        With the pip command, if an extra is missing.
    """
    methods = (method for part in (*plan.main, *plan.generalization) for method in part.methods)
    for spec in dict.fromkeys(spec for method in methods for spec in method.policy_specs):
        make_policy(spec)  # a model that is missing is not to be found out after half an hour
    return BenchmarkStudy(
        tuple(run_condition(store, condition, workers, log) for condition in plan.main),
        tuple(run_condition(store, condition, workers, log) for condition in plan.generalization),
    )


def run_condition(
    store: Path, condition: Condition, workers: int, log: Callable[[str], None]
) -> ConditionResult:
    """Let all entries of a condition play."""
    log(f"{condition.world}, {condition.label}: {condition.n_worlds} test worlds")
    groups: dict[str, list[Method]] = {}
    for method in condition.methods:  # those of one environment share its workers
        groups.setdefault(repr(sorted(method.arguments.items())), []).append(method)
    runs: dict[str, tuple[Evaluation, ...]] = {}
    for methods in groups.values():
        found = compare(
            [spec for method in methods for spec in method.policy_specs],
            range(condition.n_worlds),
            {**condition.arguments, **methods[0].arguments},
            store,
            workers=workers,
            env_name=condition.world,
        )
        for method in methods:
            runs[method.label] = tuple(found[spec] for spec in method.policy_specs)
    return ConditionResult(
        condition, tuple(MethodResult(method, runs[method.label]) for method in condition.methods)
    )


def summary(study: BenchmarkStudy) -> dict[str, Any]:
    """Everything that was found, as JSON values; intervals are 95 %."""
    main = [condition_summary(result) for result in study.main]
    return {
        "version": __version__,
        "verdicts": [verdict for found in main for verdict in verdicts(found)],
        "main": main,
        "generalization": [condition_summary(result) for result in study.generalization],
    }


def condition_summary(result: ConditionResult) -> dict[str, Any]:
    """Scores, curves, profiles and comparisons of all entries under one condition."""
    condition = result.condition
    area = AREAS[condition.world][0]
    every = np.concatenate(
        [method_result.scores[area].ravel() for method_result in result.method_results]
    )
    thresholds = np.linspace(every.min(), every.max(), N_THRESHOLDS)
    return {
        "label": condition.label,
        "world": condition.world,
        "worlds": condition.n_worlds,
        "arguments": dict(condition.arguments),
        "areas": list(AREAS[condition.world]),
        "thresholds": thresholds.tolist(),
        "methods": {
            method_result.method.label: _method_summary(method_result, result, thresholds)
            for method_result in result.method_results
        },
    }


def _method_summary(
    method_result: MethodResult, result: ConditionResult, thresholds: Array
) -> dict[str, Any]:
    method, condition = method_result.method, result.condition
    area, curve = AREAS[condition.world][0], CURVES[condition.world]
    baseline = condition.baseline_for(method)
    return {
        "family": method.family,
        "plotted": method.plotted,
        "policies": list(method.policy_specs),
        "arguments": dict(method.arguments),
        "scores": {name: _score_summary(scores) for name, scores in method_result.scores.items()},
        "curve": run_statistics.mean_curve(method_result.curves(curve), _rng()).as_dict(),
        "profile": run_statistics.performance_profile(
            method_result.scores[area], thresholds, _rng()
        ).as_dict(),
        "baseline": baseline.label if baseline else None,
        "comparisons": {
            other.label: comparison_summary(
                method_result, result.result_for(other), AREAS[condition.world]
            )
            for other in condition.compared_methods(method)
        },
    }


def _score_summary(scores: Array) -> dict[str, Any]:
    return {
        "mean": run_statistics.mean(scores, _rng()).as_dict(),
        "interquartile_mean": run_statistics.interquartile_mean(scores, _rng()).as_dict(),
        "runs": scores.mean(axis=1).tolist(),
    }


def comparison_summary(
    ours: MethodResult, theirs: MethodResult, areas: tuple[str, ...]
) -> dict[str, Any]:
    """One entry against another on the same worlds."""
    verdict_scores = (*areas, REWARD)
    return {
        "same_arguments": ours.method.arguments == theirs.method.arguments,
        "difference": {
            name: run_statistics.mean_difference(scores, theirs.scores[name]).as_dict()
            for name, scores in ours.scores.items()
            if name != "planning_time_ms"
        },
        "difference_by_run": {
            name: (ours.scores[name].mean(axis=1) - theirs.scores[name].mean()).tolist()
            for name in verdict_scores
        },
        "ratio": {
            area: run_statistics.ratio_of_means(
                ours.scores[area], theirs.scores[area], _rng()
            ).as_dict()
            for area in areas
        },
        "probability_of_improvement": {
            name: run_statistics.probability_of_improvement(
                ours.scores[name], theirs.scores[name], _rng()
            ).as_dict()
            for name in verdict_scores
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
            "planner": other,
            "difference": method["comparisons"][other]["difference"][score],
            "runs": method["comparisons"][other]["difference_by_run"][score],
            "verdict": interval_verdict(
                Interval(**method["comparisons"][other]["difference"][score])
            ),
        }
        for label, method in found["methods"].items()
        if method["family"] == LEARNED
        for score in (*found["areas"], REWARD)
        for other in verdict_planners(found["methods"], method, score)
    ]


def interval_verdict(interval: Interval) -> str:
    """What an interval of a difference says."""
    if interval.low > 0:
        return "above zero"
    return "below zero" if interval.high < 0 else "contains zero"


def verdict_planners(methods: dict[str, Any], method: dict[str, Any], score: str) -> list[str]:
    """Baseline, the planner that does best choosing alike, and those that choose any pose."""
    against = method["comparisons"]
    same = [name for name, values in against.items() if values["same_arguments"]]

    def mean(name: str) -> float:
        return float(methods[name]["scores"][score]["mean"]["estimate"])

    best = max(same, key=mean, default=None)
    wanted = [method["baseline"], best, *(name for name in against if name not in same)]
    return [name for name in dict.fromkeys(wanted) if name is not None]


def _rng() -> np.random.Generator:
    """The same draws of worlds for every statistic."""
    return np.random.default_rng(BOOTSTRAP_SEED)
