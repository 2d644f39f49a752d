"""The localization study: how the target is found, and how camera poses are corrected.

Sections 2.2 and 2.5, for two robots on worksites of the test split, moved by the rating function.
First they search for the target, parked with any heading; then, located, they map with each setting
of motion correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from coopmap_env.core.serial import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldSettings
from coopmap_env.evaluation.comparison import BOOTSTRAP_SEED, Evaluation
from coopmap_env.evaluation.jobs import Job, Result, run_jobs
from coopmap_env.evaluation.rollout import episode_from_dict
from coopmap_env.evaluation.statistics.bootstrap import (
    Interval,
    bootstrap_groups,
    bootstrap_mean,
    bootstrap_paired_difference,
)
from coopmap_env.studies.localization.episodes import run_localization_job
from coopmap_env.studies.localization.pose_estimators import LEVELS, compare_identifications

Array = NDArray[np.float64]

POLICY = "rating_function:search=100"
SETTINGS = ("kinematic", "fiducials", "exact")
SCANS_EACH = 16
"""Of each of two robots that map: 32 together."""
SEARCH_SCANS = 10
"""Of each robot that searches, at most."""
WITHIN = (1, 2, 3, 4, 5, 6, 8, 10)
"""Scans within which robots are counted as located."""
FALSE_POSITION, FALSE_ANGLE = 0.2, np.radians(5.0)
"""A base that is further off than one of these was matched with something else."""
SCENE = "worksite"
QUALITY = ("f_score", "chamfer", "log_loss", "surface")
ERRORS = ("position", "angle", "seen")
"""Of a camera's pose, metres and radians, and the mean displacement of what it saw, metres."""


@dataclass(frozen=True)
class LocalizationSize:
    """How much is run."""

    search_worlds: int
    map_worlds: int
    draws: int
    """Of the comparison of identifications."""


FULL = LocalizationSize(100, 60, 300)
QUICK = LocalizationSize(8, 3, 50)


@dataclass(frozen=True)
class LocalizationStudy:
    """All results."""

    size: LocalizationSize
    searches: list[Result]
    """One for each world; see `search_episode`."""
    runs: dict[str, list[Result]]
    """Of each setting, one for each world; see `correction_episode`."""
    identifications: dict[str, Any]
    """Without and with outliers; see `compare_identifications`."""

    @property
    def evaluations(self) -> dict[str, Evaluation]:
        """Map quality under each setting."""
        return {
            name: Evaluation(tuple(episode_from_dict(run["episode"]) for run in runs))
            for name, runs in self.runs.items()
        }


def run(
    store: Path, size: LocalizationSize, workers: int, say: Callable[[str], None]
) -> LocalizationStudy:
    """Run everything; finished episodes are kept in `store` and not run again."""
    say(f"searching for the target: {size.search_worlds} test worksites, two robots")
    jobs = [_job("search", seed, SEARCH_SCANS) for seed in range(size.search_worlds)]
    searches = run_jobs(run_localization_job, jobs, store, workers)
    say(f"mapping with {', '.join(SETTINGS)} camera poses: {size.map_worlds} test worksites")
    jobs = [
        _job("correction", seed, SCANS_EACH, initialization="located", motion_correction=setting)
        for setting in SETTINGS
        for seed in range(size.map_worlds)
    ]
    results = iter(run_jobs(run_localization_job, jobs, store, workers))
    runs = {name: [next(results) for _ in range(size.map_worlds)] for name in SETTINGS}
    say("identifications side by side")
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    identifications = {
        "no outliers": compare_identifications(rng, size.draws, 0.0),
        "a tenth has moved": compare_identifications(rng, size.draws, 0.1),
    }
    return LocalizationStudy(size, searches, runs, identifications)


def _job(kind: str, seed: int, scans: int, **others: str) -> Job:
    return {
        "version": __version__,
        "kind": kind,
        "seed": seed,
        "split": "test",
        "scans": scans,
        "scene": SCENE,
        "policy": POLICY,
        "settings": settings_to_dict(FieldSettings()),
        **others,
    }


def summary(study: LocalizationStudy) -> dict[str, Any]:
    """Everything that was found, as JSON values; intervals are 95 % bootstraps over worlds."""
    return {
        "version": __version__,
        "policy": POLICY,
        "search": search_summary(study.searches),
        "correction": correction_summary(study.runs["fiducials"]),
        "map_quality": quality_summary(study.evaluations),
        "map_quality_of_the_same_looks": same_looks_summary(study.runs["fiducials"]),
        "identification": {"noise_levels": LEVELS, **study.identifications},
    }


def search_summary(searches: list[Result]) -> dict[str, Any]:
    """Shares located within k scans, errors of the bases, false matches, times."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    n_robots = len(searches[0]["robots"])
    # a row a robot: scans until located (infinite if it never was), position, angle, nees
    groups = [
        np.array(
            [
                [found["scans"], found["position"], found["angle"], found["nees"]]
                if found
                else [np.inf, np.nan, np.nan, np.nan]
                for found in result["robots"]
            ]
        )
        for result in searches
    ]
    rows = np.concatenate(groups)
    located = np.isfinite(rows[:, 0])
    false = (rows[:, 1] > FALSE_POSITION) | (rows[:, 2] > FALSE_ANGLE)
    times = np.concatenate([result["registration_ms"] for result in searches])

    def share_within(k: int) -> dict[str, float]:
        return bootstrap_mean([float((group[:, 0] <= k).mean()) for group in groups], rng).as_dict()

    def of_located(column: int, percent: float) -> dict[str, float]:
        return bootstrap_groups(
            groups, lambda rows: float(np.nanpercentile(rows[:, column], percent)), rng
        ).as_dict()

    return {
        "worlds": len(searches),
        "robots": n_robots * len(searches),
        "located_share": {str(k): share_within(k) for k in WITHIN},
        "never_located": int((~located).sum()),
        "false_matches": int(false.sum()),
        "position_error": {"median": of_located(1, 50.0), "p95": of_located(1, 95.0)},
        "angle_error": {"median": of_located(2, 50.0), "p95": of_located(2, 95.0)},
        "largest_errors": [float(np.nanmax(rows[:, 1])), float(np.nanmax(rows[:, 2]))],
        "nees": nees_summary([group[np.isfinite(group[:, 3]), 3] for group in groups]),
        "registration_ms": {
            "median": float(np.median(times)),
            "p95": float(np.percentile(times, 95.0)),
        },
    }


def correction_summary(corrected: list[Result]) -> dict[str, Any]:
    """Errors of camera poses before and after correction, over looks of which they tell."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    every = [_looks(run) for run in corrected]
    some = [[look for look in looks if look["directions"] > 0] for looks in every]
    most = [[look for look in looks if look["directions"] > 2] for looks in every]
    count = sum(map(len, every))
    times = np.array([look["correction_ms"] for looks in every for look in looks])
    reasons = [look["reason"] for looks in every for look in looks if look["reason"]]
    return {
        "worlds": len(corrected),
        "looks": count,
        "corrected_share": sum(map(len, some)) / count,
        "well_corrected_share": sum(map(len, most)) / count,
        "nothing_in_view_share": float(
            np.mean([look["hits"] < 50 for looks in every for look in looks])
        ),
        "too_few_fiducials": len(reasons),
        "outliers": sum(look["outliers"] for looks in every for look in looks),
        "all_looks": errors_summary(every, rng),
        "corrected_looks": errors_summary(some, rng),
        "well_corrected_looks": errors_summary(most, rng),
        "nees": {
            "kinematic": nees_summary(_column(every, "kinematic", "nees")),
            "all_looks": nees_summary(_column(every, "taken", "nees")),
            "corrected_looks": nees_summary(_column(some, "taken", "nees")),
        },
        "mean_points": _mean_points_summary(every),
        "correction_ms": {
            "median": float(np.median(times)),
            "p95": float(np.percentile(times, 95.0)),
        },
    }


def errors_summary(groups: list[list[Result]], rng: np.random.Generator) -> dict[str, Any]:
    """Errors before and after, and the ratio of their medians, for each kind of error."""
    out: dict[str, Any] = {"looks": sum(map(len, groups))}
    for name in ERRORS:
        pairs = [
            np.array([[look["kinematic"][name], look["taken"][name]] for look in looks]).reshape(
                -1, 2
            )
            for looks in groups
        ]
        pairs = [rows[np.isfinite(rows).all(axis=1)] for rows in pairs]
        out[name] = {
            "before": _percentiles(pairs, 0, rng),
            "after": _percentiles(pairs, 1, rng),
            "error_ratio_median": bootstrap_groups(pairs, _ratio_of_medians, rng).as_dict(),
        }
    return out


def _percentiles(pairs: list[Array], column: int, rng: np.random.Generator) -> dict[str, Any]:
    return {
        label: bootstrap_groups(
            pairs,
            lambda rows, q=percent: _percentile(rows[:, column], q),  # type: ignore[misc]
            rng,
        ).as_dict()
        for label, percent in (("median", 50.0), ("p95", 95.0))
    }


def _percentile(values: Array, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")


def _ratio_of_medians(rows: Array) -> float:
    if not len(rows):
        return float("nan")
    before, after = np.median(rows, axis=0)
    return float(before / after)


def nees_summary(groups: list[Array]) -> dict[str, Any]:
    """Mean normalised estimation error squared of six numbers, and where it should lie.

    The band is the 95 % one of as many independent, normal errors; the interval is bootstrapped
    over worlds, of which the errors are not independent.
    """
    values = np.concatenate(groups)
    n = len(values)
    if not n:
        return {"looks": 0}
    band = stats.chi2.ppf([0.025, 0.975], 6 * n) / n
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    mean = bootstrap_groups(
        groups, lambda rows: float(rows.mean()) if len(rows) else float("nan"), rng
    )
    return {
        "looks": n,
        "mean": mean.as_dict(),
        "band": band.tolist(),
        "in_band": bool(band[0] <= mean.estimate <= band[1]),
        "within_95_quantile": float((values <= stats.chi2.ppf(0.95, 6)).mean()),
    }


def quality_summary(evaluations: dict[str, Evaluation]) -> dict[str, Any]:
    """Map quality of each setting, and paired differences of fiducials from the others."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    tables = {name: evaluation.table for name, evaluation in evaluations.items()}
    out: dict[str, Any] = {
        name: {score: bootstrap_mean(table[score], rng).as_dict() for score in QUALITY}
        for name, table in tables.items()
    }
    ours = tables["fiducials"]
    out["fiducials_minus"] = {
        other: {
            score: bootstrap_paired_difference(ours[score], tables[other][score], rng).as_dict()
            for score in QUALITY
        }
        for other in ("kinematic", "exact")
    }
    out["fiducials_over_exact"] = {
        score: float(ours[score].mean() / tables["exact"][score].mean()) for score in QUALITY
    }
    return out


def same_looks_summary(runs: list[Result]) -> dict[str, Any]:
    """Map quality of the same looks by each kind of pose, and paired differences."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)

    def column(name: str, score: str) -> Array:
        return np.array([run["same_looks"][name][score] for run in runs])

    names, scores = ("kinematic", "taken", "exact"), ("f_score", "chamfer", "log_loss")
    out: dict[str, Any] = {
        name: {score: bootstrap_mean(column(name, score), rng).as_dict() for score in scores}
        for name in names
    }
    out["taken_minus"] = {
        other: {
            score: bootstrap_paired_difference(
                column("taken", score), column(other, score), rng
            ).as_dict()
            for score in scores
        }
        for other in ("kinematic", "exact")
    }
    return out


def interval(values: dict[str, float]) -> Interval:
    """An interval that was written as JSON values."""
    return Interval(**values)


def _looks(run: Result) -> list[Result]:
    looks: list[Result] = run["looks"]
    return looks


def _column(groups: list[list[Result]], part: str, name: str) -> list[Array]:
    return [np.array([look[part][name] for look in looks], dtype=np.float64) for looks in groups]


def _mean_points_summary(groups: list[list[Result]]) -> dict[str, Any]:
    """Poses from mean points of regions, as the paper reads Eq. 10, where there were enough."""
    looks = [look for looks in groups for look in looks if look.get("mean_points")]
    if not looks:
        return {"looks": 0}
    out: dict[str, Any] = {"looks": len(looks)}
    for name in ("linear", "rigid"):
        out[name] = {
            part: float(np.median([look["mean_points"][name][part] for look in looks]))
            for part in ("position", "angle")
        }
    for name in ("kinematic", "taken"):
        out[name] = {
            part: float(np.median([look[name][part] for look in looks]))
            for part in ("position", "angle")
        }
    return out
