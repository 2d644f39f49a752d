"""Statistics of the sweep of the price of motion, as JSON values; intervals are 95 %."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.studies.benchmark.equal_motion import difference_at_equal_motion
from coopmap_env.studies.benchmark.methods import (
    LEARNED,
    MOTION,
    MotionLine,
    Opponent,
    verdict_scores,
)
from coopmap_env.studies.benchmark.study import ConditionResult, MethodResult
from coopmap_env.studies.benchmark.verdicts import interval_verdict


def sweep_summary(result: ConditionResult) -> dict[str, Any]:
    """Score and motion of every method, and the learned ones compared at equal motion."""
    condition = result.condition
    env_name = condition.env_name
    learned = [found for found in result.method_results if found.method.family == LEARNED]
    return {
        "env_name": env_name,
        "worlds": condition.n_worlds,
        "scores": list(verdict_scores(env_name)),
        "methods": {
            found.method.label: {
                "family": found.method.family,
                "policies": list(found.method.policy_specs),
                **{
                    score: training_runs.mean(found.scores[score], resampling_rng()).as_dict()
                    for score in (*verdict_scores(env_name), MOTION)
                },
            }
            for found in result.method_results
        },
        "training_worlds": training_worlds(condition.lines),
        "lines": {
            score: {
                line.family: [method.label for method in line.methods]
                for line in condition.lines
                if line.score == score
            }
            for score in verdict_scores(env_name)
        },
        "equal_motion": [
            entry
            for ours in learned
            for line in condition.lines
            if (entry := _at_equal_motion(result, ours, line))
        ],
    }


def _at_equal_motion(
    result: ConditionResult, ours: MethodResult, line: MotionLine
) -> dict[str, Any] | None:
    """The entry of one learned method and line; None if all planners of it move more."""
    planners = [result.result_for(method).scores for method in line.methods]
    found = difference_at_equal_motion(
        ours.scores[line.score],
        ours.scores[MOTION],
        np.array([scores[line.score][0] for scores in planners]),
        np.array([scores[MOTION][0] for scores in planners]),
    )
    if found is None:
        return None
    return {
        "env_name": result.condition.env_name,
        "worlds": result.condition.n_worlds,
        "training_worlds": line.training_worlds,
        "learned": ours.method.label,
        "planners": line.family,
        "score": line.score,
        "motion": found.motion,
        "is_equal": found.is_equal,
        "planners_score": found.planners_score,
        "difference": found.difference.as_dict(),
        "verdict": interval_verdict(found.difference),
    }


def training_worlds(chosen: Iterable[Opponent | MotionLine]) -> list[int]:
    """Numbers of training worlds that have chosen planners, without repetition."""
    return sorted({planners.training_worlds for planners in chosen})


def resampling_rng() -> np.random.Generator:
    """The same resamples of worlds for every statistic."""
    return np.random.default_rng(BOOTSTRAP_SEED)
