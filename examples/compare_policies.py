"""Compare policies on the same worlds, with bootstrap intervals and paired differences."""

from pathlib import Path

from coopmap_env.evaluation import compare, summarize
from coopmap_env.evaluation.statistics import Interval

POLICIES = ("rating_function:search=50", "coverage:search=50", "random")
WORLDS = range(6)
ENVIRONMENT = {"split": "test", "max_scans": 8}

evaluations = compare(POLICIES, WORLDS, ENVIRONMENT, Path("episodes"), progress=False)
summary = summarize(evaluations, reference=POLICIES[0])
for name, scores in summary.items():
    coverage, motion = (Interval(**scores[key]["mean"]) for key in ("coverage", "motion_distance"))
    print(f"{name:<26} coverage {coverage:.3f}, motion distance {motion:.0f}")
    if "comparison" in scores:
        difference = Interval(**scores["comparison"]["difference"])
        print(f"{'':<26} AUC minus {POLICIES[0]}: {difference:.4f}")
