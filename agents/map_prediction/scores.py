"""How good predictions of unknown cells are, in natural units and by their calibration."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import NonNegative, Settings, UnitInterval

N_BINS = 20
"""Bins of probability, equally wide, in which predictions are compared with what was there."""
SMALLEST = 1e-3
"""Probabilities are kept this far from 0 and 1 before their logarithm is taken."""


@dataclass(frozen=True)
class PredictionScores(Settings):
    """Means over unknown cells, weighted as in training."""

    log_loss: NonNegative
    """Mean of -ln of the probability of what was there, nats."""
    brier: UnitInterval
    """Mean squared difference between the probability and 0 or 1 (Brier 1950)."""
    calibration_error: UnitInterval
    """Expected calibration error (Naeini et al. 2015): mean difference, over the bins of
    probability, between the mean prediction and the fraction that is occupied."""


def score_predictions(
    probability: NDArray[np.float32], occupied: NDArray[np.bool_], weights: NDArray[np.float32]
) -> PredictionScores:
    """Compare predictions with the truth; arrays of one shape, weights of which one is positive."""
    p, w = probability.ravel().astype(float), weights.ravel().astype(float)
    hit = occupied.ravel()
    kept = np.clip(p, SMALLEST, 1 - SMALLEST)
    log_loss = -np.average(np.log(np.where(hit, kept, 1 - kept)), weights=w)
    brier = np.average((p - hit) ** 2, weights=w)
    bins = np.minimum((p * N_BINS).astype(np.int64), N_BINS - 1)
    excess = np.bincount(bins, weights=w * (p - hit), minlength=N_BINS)
    return PredictionScores(float(log_loss), float(brier), float(abs(excess).sum() / w.sum()))
