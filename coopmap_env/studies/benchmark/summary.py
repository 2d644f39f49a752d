"""Statistics of the comparison as JSON values; intervals are 95 %.

`coopmap_env.evaluation.statistics.training_runs` documents the intervals, which cover worlds and
training runs.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.version import __version__
from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.studies.benchmark.methods import AREAS, verdict_scores
from coopmap_env.studies.benchmark.study import BenchmarkStudy, ConditionResult, MethodResult
from coopmap_env.studies.benchmark.sweep_summary import (
    resampling_rng,
    sweep_summary,
    training_worlds,
)
from coopmap_env.studies.benchmark.verdicts import verdicts

Array = NDArray[np.float64]

CURVES = {"planar": "coverage", "field": "surface_coverage"}
"""Curve that is drawn against scans, by environment."""
N_THRESHOLDS = 61
"""Thresholds of a performance profile."""


def benchmark_summary(study: BenchmarkStudy) -> dict[str, Any]:
    """All results as JSON values."""
    main = [condition_summary(result) for result in study.main]
    return {
        "version": __version__,
        "notes": list(study.notes),
        "verdicts": [verdict for condition in main for verdict in verdicts(condition)],
        "main": main,
        "sweeps": [sweep_summary(result) for result in study.sweeps],
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
        "training_worlds": training_worlds(condition.opponents),
        "opponents": [
            {
                "score": opponent.score,
                "label": opponent.method.label,
                "env_kwargs": dict(opponent.method.env_kwargs),
                "training_mean": opponent.training_mean,
                "training_worlds": opponent.training_worlds,
            }
            for opponent in sorted(
                condition.opponents, key=lambda opponent: -opponent.training_mean
            )
        ],
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
        "curve": training_runs.mean_curve(method_result.curves(curve), resampling_rng()).as_dict(),
        "profile": training_runs.performance_profile(
            method_result.scores[area], thresholds, resampling_rng()
        ).as_dict(),
        "baseline": baseline.label if baseline else None,
        "comparisons": {
            other.label: comparison_summary(
                method_result, result.result_for(other), condition.env_name
            )
            for other in condition.compared_methods(method)
        },
    }


def _score_summary(scores: Array) -> dict[str, Any]:
    return {
        "mean": training_runs.mean(scores, resampling_rng()).as_dict(),
        "interquartile_mean": training_runs.interquartile_mean(scores, resampling_rng()).as_dict(),
        "runs": scores.mean(axis=1).tolist(),
    }


def comparison_summary(ours: MethodResult, theirs: MethodResult, env_name: str) -> dict[str, Any]:
    """One method compared with another on the same worlds."""
    return {
        "same_env_kwargs": ours.method.env_kwargs == theirs.method.env_kwargs,
        "difference": {
            name: training_runs.mean_difference(scores, theirs.scores[name]).as_dict()
            for name, scores in ours.scores.items()
            if name != "planning_time_ms"
        },
        "difference_by_run": {
            name: (ours.scores[name].mean(axis=1) - theirs.scores[name].mean()).tolist()
            for name in verdict_scores(env_name)
        },
        "ratio": {
            area: training_runs.ratio_of_means(
                ours.scores[area], theirs.scores[area], resampling_rng()
            ).as_dict()
            for area in AREAS[env_name]
        },
        "probability_of_improvement": {
            name: training_runs.probability_of_improvement(
                ours.scores[name], theirs.scores[name], resampling_rng()
            ).as_dict()
            for name in verdict_scores(env_name)
        },
    }
