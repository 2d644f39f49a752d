"""Confidence intervals and hypothesis tests over a set of worlds, and over training runs.

`training_runs` has the statistics of algorithms with several training runs.
"""

from coopmap_env.evaluation.statistics import training_runs
from coopmap_env.evaluation.statistics.bootstrap import (
    bootstrap_clusters,
    bootstrap_interquartile_mean,
    bootstrap_mean,
    bootstrap_paired_difference,
    interquartile_mean,
    percentile_bounds,
    probability_of_improvement,
)
from coopmap_env.evaluation.statistics.hypothesis_tests import (
    EquivalenceResult,
    TrendTestResult,
    equivalence_test,
    page_trend_test,
)
from coopmap_env.evaluation.statistics.interval import Interval

__all__ = [
    "EquivalenceResult",
    "Interval",
    "TrendTestResult",
    "bootstrap_clusters",
    "bootstrap_interquartile_mean",
    "bootstrap_mean",
    "bootstrap_paired_difference",
    "equivalence_test",
    "interquartile_mean",
    "page_trend_test",
    "percentile_bounds",
    "probability_of_improvement",
    "training_runs",
]
