"""Scores of policies over their worlds, with intervals."""

from __future__ import annotations

from typing import Any

import numpy as np

from coopmap_env.evaluation.comparison import EFFICIENCY_SCORES, Evaluation
from coopmap_env.evaluation.episode import SHOWN_SCORES, SURFACE_SCORES
from coopmap_env.evaluation.statistics import (
    bootstrap_interquartile_mean,
    bootstrap_mean,
    bootstrap_paired_difference,
    probability_of_improvement,
)

SUMMARY_SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "entropy",
    "log_loss",
    "brier_score",
    "motion_distance",
    "n_collisions",
    "planning_time_ms",
    *SURFACE_SCORES,
    "log_loss_free",
    "log_loss_occupied",
    *SHOWN_SCORES,
    *EFFICIENCY_SCORES,
)
"""Columns of `Episode.row` that the summary gives with intervals, if the environment has them.

A new one goes to the end: the scores draw their bootstrap samples one after the other. What else
chooses among the columns: `VALIDATION_SCORES` of `coopmap_agents.record`, and
`BENCHMARK_SCORES` of `coopmap_env.studies.benchmark.study`.
"""
BOOTSTRAP_SEED = 20_011


def summarize(evaluations: dict[str, Evaluation], reference: str | None) -> dict[str, Any]:
    """Scores of each policy with 95 % intervals, and its comparison with a reference policy.

    For every score: the mean, and the interquartile mean with its stratified bootstrap interval
    (the worlds of a policy are one stratum). Worlds where a score is undefined, such as the errors
    of surface points where the map has none, do not count; a score needs two others.
    The comparison is over the paired worlds: the probability of improvement over the reference, and
    the mean difference in the area under the coverage curve.

    Parameters
    ----------
    evaluations : dict
        By policy.
    reference : str, optional
        Name of the reference policy.
    """
    summary: dict[str, Any] = {}
    for name, evaluation in evaluations.items():
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        table = evaluation.table
        entry: dict[str, Any] = {"episodes": len(evaluation.episodes)}
        if len(evaluation.episodes) > 1:
            for score in (score for score in SUMMARY_SCORES if score in table):
                values = table[score]
                defined = values[~np.isnan(values)]
                if len(defined) > 1:
                    entry[score] = {
                        "mean": bootstrap_mean(defined, rng).as_dict(),
                        "interquartile_mean": bootstrap_interquartile_mean(
                            [defined], rng
                        ).as_dict(),
                    }
            if reference is not None and name != reference:
                ours, theirs = table["coverage_auc"], evaluations[reference].table["coverage_auc"]
                entry["comparison"] = {
                    "policy": reference,
                    "score": "coverage_auc",
                    "probability_of_improvement": probability_of_improvement(
                        ours, theirs, rng
                    ).as_dict(),
                    "difference": bootstrap_paired_difference(ours, theirs, rng).as_dict(),
                }
        summary[name] = entry
    return summary
