"""Statistics of the sweep of the price of motion, as JSON values; intervals are 95 %."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.studies.benchmark.equal_motion import difference_at_equal_motion, undominated
from coopmap_env.studies.benchmark.methods import LEARNED, verdict_scores
from coopmap_env.studies.benchmark.study import ConditionResult, MethodResult
from coopmap_env.studies.benchmark.verdicts import ALL_PLANNERS, interval_verdict

MOTION = "motion_distance"


def sweep_summary(result: ConditionResult) -> dict[str, Any]:
    """Score and motion of every method, and the learned ones compared at equal motion."""
    env_name = result.condition.env_name
    families = _families(result)
    learned = [found for found in result.method_results if found.method.family == LEARNED]
    return {
        "env_name": env_name,
        "worlds": result.condition.n_worlds,
        "scores": list(verdict_scores(env_name)),
        "methods": {
            found.method.label: {
                "family": found.method.family,
                "policies": list(found.method.policy_specs),
                **{
                    score: training_runs.mean(found.scores[score], _rng()).as_dict()
                    for score in (*verdict_scores(env_name), MOTION)
                },
            }
            for found in result.method_results
        },
        "undominated": {
            score: {
                family: [found.method.label for found in _undominated(members, score)]
                for family, members in families.items()
            }
            for score in verdict_scores(env_name)
        },
        "equal_motion": [
            entry
            for ours in learned
            for score in verdict_scores(env_name)
            for family, members in families.items()
            if (entry := _at_equal_motion(env_name, ours, family, members, score))
        ],
    }


def _families(result: ConditionResult) -> dict[str, list[MethodResult]]:
    """Planners by family, and all of them together."""
    planners = [found for found in result.method_results if found.method.family != LEARNED]
    families: dict[str, list[MethodResult]] = {ALL_PLANNERS: planners}
    for found in planners:
        families.setdefault(found.method.family, []).append(found)
    return families


def _undominated(members: list[MethodResult], score: str) -> list[MethodResult]:
    rows = undominated(
        np.array([found.scores[score].mean() for found in members]),
        np.array([found.scores[MOTION].mean() for found in members]),
    )
    return [members[row] for row in rows]


def _at_equal_motion(
    env_name: str, ours: MethodResult, family: str, members: list[MethodResult], score: str
) -> dict[str, Any] | None:
    """The entry of one learned method, family and score; None if all planners move more."""
    found = difference_at_equal_motion(
        ours.scores[score],
        ours.scores[MOTION],
        np.array([planner.scores[score][0] for planner in members]),
        np.array([planner.scores[MOTION][0] for planner in members]),
    )
    if found is None:
        return None
    return {
        "env_name": env_name,
        "learned": ours.method.label,
        "planners": family,
        "score": score,
        "motion": found.motion,
        "is_equal": found.is_equal,
        "planners_score": found.planners_score,
        "difference": found.difference.as_dict(),
        "verdict": interval_verdict(found.difference),
    }


def _rng() -> np.random.Generator:
    """The same resamples of worlds for every statistic."""
    return np.random.default_rng(BOOTSTRAP_SEED)
