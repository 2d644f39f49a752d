"""Scores of maps against the true world: calibration, and the true surface."""

from coopmap_env.evaluation.metrics._triangle_distance import surface_offsets
from coopmap_env.evaluation.metrics.calibration import (
    ReliabilityCurve,
    binary_log_loss,
    brier_score,
    expected_calibration_error,
    log_loss,
    observed_mask,
    reliability_curve,
)
from coopmap_env.evaluation.metrics.surface import SurfaceEvaluator
from coopmap_env.evaluation.metrics.surface_consistency import (
    SurfaceConsistency,
    cell_face_offsets,
    surface_chi2,
)
from coopmap_env.evaluation.metrics.surface_scores import SampleVoxels, SurfaceScores

__all__ = [
    "ReliabilityCurve",
    "SampleVoxels",
    "SurfaceConsistency",
    "SurfaceEvaluator",
    "SurfaceScores",
    "binary_log_loss",
    "brier_score",
    "cell_face_offsets",
    "expected_calibration_error",
    "log_loss",
    "observed_mask",
    "reliability_curve",
    "surface_chi2",
    "surface_offsets",
]
