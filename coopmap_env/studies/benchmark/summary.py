"""Statistics of the comparison as JSON values; intervals are 95 %.

`coopmap_env.evaluation.statistics.training_runs` documents the intervals, which cover worlds and
training runs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.version import __version__
from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import Interval, training_runs
from coopmap_env.studies.benchmark.methods import LEARNED
from coopmap_env.studies.benchmark.study import BenchmarkStudy, ConditionResult, MethodResult

Array = NDArray[np.float64]

CURVES = {"planar": "coverage", "field": "surface_coverage"}
"""Curve that is drawn against scans, by environment."""
AREAS = {"planar": ("coverage_auc",), "field": ("surface_coverage_auc", "coverage_auc")}
"""Areas under coverage curves, by environment; the first belongs to the drawn curve."""
REWARD = "reward"
"""The planner's own objective; verdicts are about it and about the areas."""
N_THRESHOLDS = 61
"""Thresholds of a performance profile."""


def benchmark_summary(study: BenchmarkStudy) -> dict[str, Any]:
    """All results as JSON values."""
    main = [condition_summary(result) for result in study.main]
    return {
        "version": __version__,
        "verdicts": [verdict for condition in main for verdict in verdicts(condition)],
        "main": main,
        "generalization": [condition_summary(result) for result in study.generalization],
    }


def condition_summary(result: ConditionResult) -> dict[str, Any]:
    """Scores, curves, profiles and comparisons of all methods under one condition."""
    condition = result.condition
    area = AREAS[condition.env_name][0]
    values = np.concatenate(
        [method_result.scores[area].ravel() for method_result in result.method_results]
    )
    thresholds = np.linspace(values.min(), values.max(), N_THRESHOLDS)
    return {
        "label": condition.label,
        "env_name": condition.env_name,
        "worlds": condition.n_worlds,
        "env_kwargs": dict(condition.env_kwargs),
        "areas": list(AREAS[condition.env_name]),
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
    area, curve = AREAS[condition.env_name][0], CURVES[condition.env_name]
    baseline = condition.baseline_for(method)
    return {
        "family": method.family,
        "plotted": method.plotted,
        "policies": list(method.policy_specs),
        "env_kwargs": dict(method.env_kwargs),
        "scores": {name: _score_summary(scores) for name, scores in method_result.scores.items()},
        "curve": training_runs.mean_curve(method_result.curves(curve), _rng()).as_dict(),
        "profile": training_runs.performance_profile(
            method_result.scores[area], thresholds, _rng()
        ).as_dict(),
        "baseline": baseline.label if baseline else None,
        "comparisons": {
            other.label: comparison_summary(
                method_result, result.result_for(other), AREAS[condition.env_name]
            )
            for other in condition.compared_methods(method)
        },
    }


def _score_summary(scores: Array) -> dict[str, Any]:
    return {
        "mean": training_runs.mean(scores, _rng()).as_dict(),
        "interquartile_mean": training_runs.interquartile_mean(scores, _rng()).as_dict(),
        "runs": scores.mean(axis=1).tolist(),
    }


def comparison_summary(
    ours: MethodResult, theirs: MethodResult, areas: tuple[str, ...]
) -> dict[str, Any]:
    """One method compared with another on the same worlds."""
    verdict_scores = (*areas, REWARD)
    return {
        "same_env_kwargs": ours.method.env_kwargs == theirs.method.env_kwargs,
        "difference": {
            name: training_runs.mean_difference(scores, theirs.scores[name]).as_dict()
            for name, scores in ours.scores.items()
            if name != "planning_time_ms"
        },
        "difference_by_run": {
            name: (ours.scores[name].mean(axis=1) - theirs.scores[name].mean()).tolist()
            for name in verdict_scores
        },
        "ratio": {
            area: training_runs.ratio_of_means(
                ours.scores[area], theirs.scores[area], _rng()
            ).as_dict()
            for area in areas
        },
        "probability_of_improvement": {
            name: training_runs.probability_of_improvement(
                ours.scores[name], theirs.scores[name], _rng()
            ).as_dict()
            for name in verdict_scores
        },
    }


def verdicts(condition: dict[str, Any]) -> list[dict[str, Any]]:
    """Differences of learned policies from planners in areas and reward, with verdicts.

    Each learned method is compared with its baseline, with the planner that has the best score on
    the same candidates, and with the reference planner, as far as the condition has them.
    """
    return [
        {
            "env_name": condition["env_name"],
            "score": score,
            "learned": label,
            "planner": other,
            "difference": method["comparisons"][other]["difference"][score],
            "runs": method["comparisons"][other]["difference_by_run"][score],
            "verdict": interval_verdict(
                Interval(**method["comparisons"][other]["difference"][score])
            ),
        }
        for label, method in condition["methods"].items()
        if method["family"] == LEARNED
        for score in (*condition["areas"], REWARD)
        for other in verdict_planners(condition["methods"], method, score)
    ]


def interval_verdict(interval: Interval) -> str:
    """Position of the interval of a difference relative to zero."""
    if interval.low > 0:
        return "above zero"
    return "below zero" if interval.high < 0 else "contains zero"


def verdict_planners(methods: dict[str, Any], method: dict[str, Any], score: str) -> list[str]:
    """Baseline, the best planner with the same actions, and planners with other actions."""
    comparisons = method["comparisons"]
    same = [name for name, values in comparisons.items() if values["same_env_kwargs"]]

    def mean(name: str) -> float:
        return float(methods[name]["scores"][score]["mean"]["estimate"])

    best = max(same, key=mean, default=None)
    planners = [method["baseline"], best, *(name for name in comparisons if name not in same)]
    return [name for name in dict.fromkeys(planners) if name is not None]


def _rng() -> np.random.Generator:
    """The same resamples of worlds for every statistic."""
    return np.random.default_rng(BOOTSTRAP_SEED)
