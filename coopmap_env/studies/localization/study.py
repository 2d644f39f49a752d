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
    bootstrap_clusters,
    bootstrap_mean,
    bootstrap_paired_difference,
)
from coopmap_env.studies.localization.episodes import run_localization_job
from coopmap_env.studies.localization.pose_estimators import NOISE_FACTORS, compare_pose_estimators

Array = NDArray[np.float64]

POLICY = "rating_function:search=100"
CORRECTION_MODES = ("kinematic", "fiducials", "exact")
SCANS_EACH = 16
"""Of each of two robots that map: 32 together."""
SEARCH_SCANS = 10
"""Of each robot that searches, at most."""
SCAN_LIMITS = (1, 2, 3, 4, 5, 6, 8, 10)
"""Scans within which robots are counted as located."""
FALSE_MATCH_POSITION, FALSE_MATCH_ANGLE = 0.2, np.radians(5.0)
"""A base that is further off than one of these was matched with something else."""
SCENE = "worksite"
QUALITY_SCORES = ("f_score", "chamfer", "log_loss", "surface")
ERROR_NAMES = ("position", "angle", "point_displacement")
"""Of a camera's pose, metres and radians, and the mean displacement of what it saw, metres."""


@dataclass(frozen=True)
class LocalizationSize:
    """How much is run."""

    search_worlds: int
    map_worlds: int
    n_draws: int
    """Of the comparison of identifications."""


FULL = LocalizationSize(100, 60, 300)
QUICK = LocalizationSize(8, 3, 50)


@dataclass(frozen=True)
class LocalizationStudy:
    """All results."""

    size: LocalizationSize
    searches: list[Result]
    """One for each world; see `run_search_episode`."""
    runs: dict[str, list[Result]]
    """Of each setting, one for each world; see `run_correction_episode`."""
    pose_estimators: dict[str, Any]
    """Without and with outliers; see `compare_pose_estimators`."""

    @property
    def evaluations(self) -> dict[str, Evaluation]:
        """Map quality under each setting."""
        return {
            name: Evaluation(tuple(episode_from_dict(run["episode"]) for run in runs))
            for name, runs in self.runs.items()
        }


def run(
    store: Path, size: LocalizationSize, workers: int, log: Callable[[str], None]
) -> LocalizationStudy:
    """Run everything; finished episodes are kept in `store` and not run again."""
    log(f"searching for the target: {size.search_worlds} test worksites, two robots")
    jobs = [_make_job("search", seed, SEARCH_SCANS) for seed in range(size.search_worlds)]
    searches = run_jobs(run_localization_job, jobs, store, workers)
    log(
        f"mapping with {', '.join(CORRECTION_MODES)} camera poses: {size.map_worlds} test worksites"
    )
    jobs = [
        _make_job(
            "correction", seed, SCANS_EACH, initialization="located", motion_correction=setting
        )
        for setting in CORRECTION_MODES
        for seed in range(size.map_worlds)
    ]
    results = iter(run_jobs(run_localization_job, jobs, store, workers))
    runs = {name: [next(results) for _ in range(size.map_worlds)] for name in CORRECTION_MODES}
    log("identifications side by side")
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    pose_estimators = {
        "without outliers": compare_pose_estimators(rng, size.n_draws, 0.0),
        "10 % outliers": compare_pose_estimators(rng, size.n_draws, 0.1),
    }
    return LocalizationStudy(size, searches, runs, pose_estimators)


def _make_job(kind: str, seed: int, scans: int, **environment: str) -> Job:
    return {
        "version": __version__,
        "kind": kind,
        "seed": seed,
        "split": "test",
        "max_scans": scans,
        "scene": SCENE,
        "policy": POLICY,
        "settings": settings_to_dict(FieldSettings()),
        **environment,
    }


def summary(study: LocalizationStudy) -> dict[str, Any]:
    """Everything that was found, as JSON values; intervals are 95 % bootstraps over worlds."""
    return {
        "version": __version__,
        "policy": POLICY,
        "search": search_summary(study.searches),
        "correction": correction_summary(study.runs["fiducials"]),
        "map_quality": quality_summary(study.evaluations),
        "map_quality_same_scans": same_scans_summary(study.runs["fiducials"]),
        "identification": {"noise_factors": NOISE_FACTORS, **study.pose_estimators},
    }


def search_summary(searches: list[Result]) -> dict[str, Any]:
    """Shares located within k scans, errors of the bases, false matches, times."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    n_robots = len(searches[0]["robots"])
    # a row a robot: scans until located (infinite if it never was), position, angle, nees
    groups = [
        np.array(
            [
                [found["n_scans"], found["position"], found["angle"], found["nees"]]
                if found
                else [np.inf, np.nan, np.nan, np.nan]
                for found in result["robots"]
            ]
        )
        for result in searches
    ]
    rows = np.concatenate(groups)
    located = np.isfinite(rows[:, 0])
    is_false_match = (rows[:, 1] > FALSE_MATCH_POSITION) | (rows[:, 2] > FALSE_MATCH_ANGLE)
    times = np.concatenate([result["registration_ms"] for result in searches])

    def located_fraction_within(k: int) -> dict[str, float]:
        return bootstrap_mean([float((group[:, 0] <= k).mean()) for group in groups], rng).as_dict()

    def percentile_of_located(column: int, percent: float) -> dict[str, float]:
        return bootstrap_clusters(
            groups, lambda rows: float(np.nanpercentile(rows[:, column], percent)), rng
        ).as_dict()

    return {
        "worlds": len(searches),
        "robots": n_robots * len(searches),
        "located_fraction": {str(k): located_fraction_within(k) for k in SCAN_LIMITS},
        "never_located": int((~located).sum()),
        "false_matches": int(is_false_match.sum()),
        "position_error": {
            "median": percentile_of_located(1, 50.0),
            "p95": percentile_of_located(1, 95.0),
        },
        "angle_error": {
            "median": percentile_of_located(2, 50.0),
            "p95": percentile_of_located(2, 95.0),
        },
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
    all_scans = [_scan_records(run) for run in corrected]
    corrected_scans = [
        [scan for scan in scans if scan["corrected_directions"] > 0] for scans in all_scans
    ]
    well_corrected_scans = [
        [scan for scan in scans if scan["corrected_directions"] > 2] for scans in all_scans
    ]
    count = sum(map(len, all_scans))
    times = np.array([scan["correction_ms"] for scans in all_scans for scan in scans])
    reasons = [
        scan["correction_failure"]
        for scans in all_scans
        for scan in scans
        if scan["correction_failure"]
    ]
    return {
        "worlds": len(corrected),
        "scans": count,
        "corrected_fraction": sum(map(len, corrected_scans)) / count,
        "well_corrected_fraction": sum(map(len, well_corrected_scans)) / count,
        "nothing_in_view_fraction": float(
            np.mean([scan["n_hits"] < 50 for scans in all_scans for scan in scans])
        ),
        "too_few_fiducials": len(reasons),
        "outliers": sum(scan["n_outliers"] for scans in all_scans for scan in scans),
        "all_scans": errors_summary(all_scans, rng),
        "corrected_scans": errors_summary(corrected_scans, rng),
        "well_corrected_scans": errors_summary(well_corrected_scans, rng),
        "nees": {
            "kinematic": nees_summary(_error_columns(all_scans, "kinematic", "nees")),
            "all_scans": nees_summary(_error_columns(all_scans, "estimated", "nees")),
            "corrected_scans": nees_summary(_error_columns(corrected_scans, "estimated", "nees")),
        },
        "mean_points": _mean_points_summary(all_scans),
        "correction_ms": {
            "median": float(np.median(times)),
            "p95": float(np.percentile(times, 95.0)),
        },
    }


def errors_summary(groups: list[list[Result]], rng: np.random.Generator) -> dict[str, Any]:
    """Errors before and after, and the ratio of their medians, for each kind of error."""
    out: dict[str, Any] = {"scans": sum(map(len, groups))}
    for name in ERROR_NAMES:
        pairs = [
            np.array(
                [[scan["kinematic"][name], scan["estimated"][name]] for scan in scans]
            ).reshape(-1, 2)
            for scans in groups
        ]
        pairs = [rows[np.isfinite(rows).all(axis=1)] for rows in pairs]
        out[name] = {
            "before": _percentiles(pairs, 0, rng),
            "after": _percentiles(pairs, 1, rng),
            "error_ratio_median": bootstrap_clusters(pairs, _ratio_of_medians, rng).as_dict(),
        }
    return out


def _percentiles(pairs: list[Array], column: int, rng: np.random.Generator) -> dict[str, Any]:
    return {
        label: bootstrap_clusters(
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
        return {"scans": 0}
    band = stats.chi2.ppf([0.025, 0.975], 6 * n) / n
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    mean = bootstrap_clusters(
        groups, lambda rows: float(rows.mean()) if len(rows) else float("nan"), rng
    )
    return {
        "scans": n,
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
        name: {score: bootstrap_mean(table[score], rng).as_dict() for score in QUALITY_SCORES}
        for name, table in tables.items()
    }
    ours = tables["fiducials"]
    out["fiducials_minus"] = {
        other: {
            score: bootstrap_paired_difference(ours[score], tables[other][score], rng).as_dict()
            for score in QUALITY_SCORES
        }
        for other in ("kinematic", "exact")
    }
    out["fiducials_over_exact"] = {
        score: float(ours[score].mean() / tables["exact"][score].mean()) for score in QUALITY_SCORES
    }
    return out


def same_scans_summary(runs: list[Result]) -> dict[str, Any]:
    """Map quality of the same looks by each kind of pose, and paired differences."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)

    def column(name: str, score: str) -> Array:
        return np.array([run["same_scans"][name][score] for run in runs])

    names, scores = ("kinematic", "estimated", "exact"), ("f_score", "chamfer", "log_loss")
    out: dict[str, Any] = {
        name: {score: bootstrap_mean(column(name, score), rng).as_dict() for score in scores}
        for name in names
    }
    out["estimated_minus"] = {
        other: {
            score: bootstrap_paired_difference(
                column("estimated", score), column(other, score), rng
            ).as_dict()
            for score in scores
        }
        for other in ("kinematic", "exact")
    }
    return out


def interval_from_dict(values: dict[str, float]) -> Interval:
    """An interval that was written as JSON values."""
    return Interval(**values)


def _scan_records(run: Result) -> list[Result]:
    scans: list[Result] = run["scans"]
    return scans


def _error_columns(groups: list[list[Result]], part: str, name: str) -> list[Array]:
    return [np.array([scan[part][name] for scan in scans], dtype=np.float64) for scans in groups]


def _mean_points_summary(groups: list[list[Result]]) -> dict[str, Any]:
    """Poses from mean points of regions, as the paper reads Eq. 10, where there were enough."""
    scans = [scan for scans in groups for scan in scans if scan.get("mean_points")]
    if not scans:
        return {"scans": 0}
    out: dict[str, Any] = {"scans": len(scans)}
    for name in ("linear", "rigid"):
        out[name] = {
            part: float(np.median([scan["mean_points"][name][part] for scan in scans]))
            for part in ("position", "angle")
        }
    for name in ("kinematic", "estimated"):
        out[name] = {
            part: float(np.median([scan[name][part] for scan in scans]))
            for part in ("position", "angle")
        }
    return out
