"""Results of the localization study as JSON values; intervals are 95 % bootstraps over worlds."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from coopmap_env.core.version import __version__
from coopmap_env.evaluation import BOOTSTRAP_SEED, Result
from coopmap_env.evaluation.statistics import bootstrap_clusters, bootstrap_mean
from coopmap_env.studies.localization.episodes import MIN_POINTS
from coopmap_env.studies.localization.estimator_comparison import NOISE_FACTORS
from coopmap_env.studies.localization.map_quality import (
    ESTIMATES,
    quality_summary,
    same_scans_summary,
)
from coopmap_env.studies.localization.study import POLICY, LocalizationStudy
from coopmap_env.studies.localization.verdicts import verdicts

Array = NDArray[np.float64]

SCAN_LIMITS = (1, 2, 3, 4, 5, 6, 8, 10)
"""Numbers of scans at which the located robots are counted."""
FALSE_MATCH_POSITION, FALSE_MATCH_ANGLE = 0.2, np.radians(5.0)
"""Metres, radians: a base with a larger error of either kind is a false match."""
ERROR_NAMES = ("position", "angle", "point_displacement")
"""Errors of a camera pose: metres, radians, and the mean displacement of its points, metres."""


def localization_summary(study: LocalizationStudy) -> dict[str, Any]:
    """All results as JSON values."""
    summary: dict[str, Any] = {
        "version": __version__,
        "policy": POLICY,
        "search": search_summary(study.searches),
        "correction": correction_summary(study.runs["fiducials"]),
        "map_quality": quality_summary(study.evaluations),
        "map_quality_same_scans": same_scans_summary(study.runs["fiducials"]),
        "pose_estimators": {"noise_factors": NOISE_FACTORS, **study.pose_estimators},
    }
    summary["verdicts"] = verdicts(summary["correction"], summary["map_quality_same_scans"])
    return summary


def search_summary(searches: list[Result]) -> dict[str, Any]:
    """Fractions located within k scans, errors of the bases, false matches, times."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    n_robots = len(searches[0]["robots"])
    # one row per robot: scans until located (infinite if never), position, angle, nees
    groups = [
        np.array(
            [
                [robot["n_scans"], robot["position"], robot["angle"], robot["nees"]]
                if robot
                else [np.inf, np.nan, np.nan, np.nan]
                for robot in result["robots"]
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
    """Errors of camera poses before and after correction, by the number of corrected directions."""
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
            np.mean([scan["n_hits"] < MIN_POINTS for scans in all_scans for scan in scans])
        ),
        "too_few_fiducials": len(reasons),
        "noise_floor": float(
            np.median([scan["noise_floor"] for scans in all_scans for scan in scans])
        ),
        "outliers": sum(scan["n_outliers"] for scans in all_scans for scan in scans),
        "all_scans": errors_summary(all_scans, rng),
        "corrected_scans": errors_summary(corrected_scans, rng),
        "well_corrected_scans": errors_summary(well_corrected_scans, rng),
        "nees": {
            name: {
                "all_scans": nees_summary(_error_columns(all_scans, name, "nees")),
                "corrected_scans": nees_summary(_error_columns(corrected_scans, name, "nees")),
            }
            for name in ESTIMATES
        },
        "mean_points": _mean_points_summary(all_scans),
        "correction_ms": {
            "median": float(np.median(times)),
            "p95": float(np.percentile(times, 95.0)),
        },
    }


def errors_summary(groups: list[list[Result]], rng: np.random.Generator) -> dict[str, Any]:
    """Errors of each kind of camera pose, and how many times smaller they are than the encoders'.

    The ratio is that of the medians, in the same scans.
    """
    out: dict[str, Any] = {"scans": sum(map(len, groups))}
    for name in ERROR_NAMES:
        rows = [
            np.array([[scan[kind][name] for kind in ESTIMATES] for scan in scans]).reshape(
                -1, len(ESTIMATES)
            )
            for scans in groups
        ]
        rows = [of_world[np.isfinite(of_world).all(axis=1)] for of_world in rows]
        out[name] = {
            kind: {
                **_percentiles(rows, k, rng),
                "error_ratio": bootstrap_clusters(
                    rows, partial(_ratio_of_medians, column=k), rng
                ).as_dict(),
                "p95_minus_kinematic": bootstrap_clusters(
                    rows, partial(_p95_minus_kinematic, column=k), rng
                ).as_dict(),
            }
            for k, kind in enumerate(ESTIMATES)
        }
    return out


def _percentiles(rows: list[Array], column: int, rng: np.random.Generator) -> dict[str, Any]:
    return {
        label: bootstrap_clusters(
            rows,
            lambda rows, q=percent: _percentile(rows[:, column], q),  # type: ignore[misc]
            rng,
        ).as_dict()
        for label, percent in (("median", 50.0), ("p95", 95.0))
    }


def _percentile(values: Array, percent: float) -> float:
    return float(np.percentile(values, percent)) if len(values) else float("nan")


def _ratio_of_medians(rows: Array, column: int) -> float:
    if not len(rows):
        return float("nan")
    return float(np.median(rows[:, 0]) / np.median(rows[:, column]))


def _p95_minus_kinematic(rows: Array, column: int) -> float:
    """Difference of the 95th percentiles of a kind of pose and of the uncorrected prediction."""
    if not len(rows):
        return float("nan")
    prior = ESTIMATES.index("kinematic")
    return float(np.percentile(rows[:, column], 95.0) - np.percentile(rows[:, prior], 95.0))


def nees_summary(groups: list[Array]) -> dict[str, Any]:
    """Mean normalised estimation error squared (NEES) of six numbers, and its expected band.

    The band is the 95 % band of as many independent normal errors. The interval is bootstrapped
    over worlds, because errors of one world are not independent.
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


def _scan_records(run: Result) -> list[Result]:
    scans: list[Result] = run["scans"]
    return scans


def _error_columns(groups: list[list[Result]], part: str, name: str) -> list[Array]:
    return [np.array([scan[part][name] for scan in scans], dtype=np.float64) for scans in groups]


def _mean_points_summary(groups: list[list[Result]]) -> dict[str, Any]:
    """Errors of poses from the mean points of regions, the literal interpretation of Eq. 10."""
    scans = [scan for scans in groups for scan in scans if scan.get("mean_points")]
    if not scans:
        return {"scans": 0}
    out: dict[str, Any] = {"scans": len(scans)}
    for name in ("linear", "rigid"):
        out[name] = {
            part: float(np.median([scan["mean_points"][name][part] for scan in scans]))
            for part in ("position", "angle")
        }
    for name in ("encoders", "estimated"):
        out[name] = {
            part: float(np.median([scan[name][part] for scan in scans]))
            for part in ("position", "angle")
        }
    return out
