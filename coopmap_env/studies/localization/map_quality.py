"""Quality of maps by the way in which camera poses are estimated; see `summary`."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation, Result
from coopmap_env.evaluation.statistics import (
    bootstrap_clusters,
    bootstrap_mean,
    bootstrap_paired_difference,
)
from coopmap_env.studies.localization.episodes import POSE_KINDS

Array = NDArray[np.float64]

QUALITY_SCORES = ("f_score", "chamfer", "log_loss", "surface_coverage")
SAME_SCANS_SCORES = ("f_score", "chamfer", "log_loss")
ESTIMATES = tuple(kind for kind in POSE_KINDS if kind != "exact")
"""Kinds of camera poses that have an error, the encoders' first."""


def quality_summary(evaluations: dict[str, Evaluation]) -> dict[str, Any]:
    """Map quality of each correction mode, and paired differences of fiducials from the others."""
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
        for other in ("encoders", "kinematic", "exact")
    }
    out["fiducials_over_exact"] = {
        score: float(ours[score].mean() / tables["exact"][score].mean()) for score in QUALITY_SCORES
    }
    return out


def same_scans_summary(runs: list[Result]) -> dict[str, Any]:
    """Map quality of the same scans by each kind of pose, and the parts of the gap they close.

    The gap is that between the maps by the encoders' poses and by the exact ones.
    """
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    tables = [
        np.array([[run["same_scans"][kind][score] for kind in POSE_KINDS] for run in runs])
        for score in SAME_SCANS_SCORES
    ]
    out: dict[str, Any] = {
        kind: {
            score: bootstrap_mean(table[:, k], rng).as_dict()
            for score, table in zip(SAME_SCANS_SCORES, tables, strict=True)
        }
        for k, kind in enumerate(POSE_KINDS)
    }
    out["gap_closed"] = {
        kind: {
            score: bootstrap_clusters(
                [row[None] for row in table], partial(_gap_closed, column=k), rng
            ).as_dict()
            for score, table in zip(SAME_SCANS_SCORES, tables, strict=True)
        }
        for k, kind in enumerate(POSE_KINDS)
        if kind in ESTIMATES[1:]
    }
    smoothed, fused = POSE_KINDS.index("smoothed"), POSE_KINDS.index("estimated")
    out["smoothed_minus_estimated"] = {
        score: bootstrap_paired_difference(table[:, smoothed], table[:, fused], rng).as_dict()
        for score, table in zip(SAME_SCANS_SCORES, tables, strict=True)
    }
    return out


def _gap_closed(rows: Array, column: int) -> float:
    """Part of the mean difference between encoders and exact poses that a kind of pose closes."""
    means = rows.mean(axis=0)
    return float((means[column] - means[0]) / (means[-1] - means[0]))
