"""Quality of a map's probabilities: proper scores and calibration against the truth.

A map is scored over the sampled cells. How much of the world they are is another score: coverage.

===========================  ============  ======================================================
score                        unit          best, uninformed (p = ½)
===========================  ============  ======================================================
Brier score                  probability²  0, ¼
log loss                     nats          0, ln 2
expected calibration error   probability   0, distance of ½ from the fraction of occupied cells
===========================  ============  ======================================================
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class ReliabilityCurve:
    """Predicted probability and observed frequency by bin; empty bins hold NaN.

    Bin ``b`` holds ``edges[b] <= p < edges[b + 1]``; the last one holds p = 1 as well.
    """

    edges: NDArray[np.float64]
    """Borders of the bins (n_bins + 1,), uniform over [0, 1]."""
    mean_predicted: NDArray[np.float64]
    """Mean probability of the bin's cells (n_bins,)."""
    occupied_fraction: NDArray[np.float64]
    """Fraction of the bin's cells that are occupied (n_bins,)."""
    counts: NDArray[np.int64]
    """Cells in the bin (n_bins,)."""


def brier_score(probability: ArrayLike, occupied: ArrayLike, sampled: ArrayLike) -> float:
    """Mean squared distance of the probability from the truth: Σ (p - o)² / N.

    Parameters
    ----------
    probability : array_like of float
        P(occupied) of each cell, any shape.
    occupied : array_like of bool
        The truth, same shape.
    sampled : array_like of bool
        Cells to score, same shape; N of them are true.

    Returns
    -------
    float
        In [0, 1]; NaN if no cell is sampled.

    Raises
    ------
    ValueError
        If the shapes differ, or a sampled probability lies outside [0, 1].

    References
    ----------
    Brier (1950), "Verification of forecasts expressed in terms of probability".
    """
    p, o = _sampled_cells(probability, occupied, sampled)
    return _mean((p - o) ** 2)


def log_loss(probability: ArrayLike, occupied: ArrayLike, sampled: ArrayLike) -> float:
    """Mean negative log-likelihood of the truth, in nats: -Σ (o ln p + (1 - o) ln(1 - p)) / N.

    Parameters, errors and the NaN of an unsampled map are those of `brier_score`.

    Returns
    -------
    float
        In [0, ∞]. One cell that is certain and wrong (p exactly 0 where occupied, exactly 1 where
        free) makes it infinite. Nothing is clipped here: the map's own clamp prevents it.
    """
    p, o = _sampled_cells(probability, occupied, sampled)
    return _mean(binary_log_loss(p, o))


def binary_log_loss(probability: ArrayLike, outcome: ArrayLike) -> NDArray[np.float64]:
    """Negative log-likelihood of binary outcomes, in nats: -ln p if it happened, else -ln(1 - p).

    Parameters
    ----------
    probability : array_like of float
        Predicted probability of the outcome, in [0, 1].
    outcome : array_like of bool
        Whether it happened; broadcast against `probability`.

    Returns
    -------
    ndarray of float
        Zero where certain and right, infinite where certain and wrong, without a warning.
    """
    p, outcome = np.broadcast_arrays(np.asarray(probability, dtype=np.float64), outcome)
    with np.errstate(divide="ignore"):
        # adding 0.0 turns the -0.0 of a certain and right cell into 0.0
        return -np.where(outcome.astype(bool), np.log(p), np.log1p(-p)) + 0.0


def reliability_curve(
    probability: ArrayLike, occupied: ArrayLike, sampled: ArrayLike, n_bins: int = 10
) -> ReliabilityCurve:
    """Group sampled cells by their probability, and count the occupied ones of each group.

    The curve of a calibrated map is the diagonal: of the cells with p = 0.3, three in ten are
    occupied.

    Parameters
    ----------
    probability, occupied, sampled : array_like
        As in `brier_score`.
    n_bins : int
        Uniform bins over [0, 1].

    Raises
    ------
    ValueError
        As in `brier_score`, or if `n_bins` is below 1.
    """
    if n_bins < 1:
        raise ValueError(f"n_bins must be at least 1, got {n_bins}")
    p, o = _sampled_cells(probability, occupied, sampled)
    # k / n is the float that a reader writes (0.3), which linspace misses by a rounding
    edges = np.arange(n_bins + 1) / n_bins
    bins = np.minimum(np.searchsorted(edges, p, side="right") - 1, n_bins - 1)
    counts = np.bincount(bins, minlength=n_bins)
    return ReliabilityCurve(
        edges=edges,
        mean_predicted=_ratio(np.bincount(bins, weights=p, minlength=n_bins), counts),
        occupied_fraction=_ratio(np.bincount(bins, weights=o, minlength=n_bins), counts),
        counts=counts,
    )


def expected_calibration_error(
    probability: ArrayLike, occupied: ArrayLike, sampled: ArrayLike, n_bins: int = 10
) -> float:
    """Mean distance of the reliability curve from the diagonal, weighted by count.

    Σ_b n_b/N ``abs(observed_b - predicted_b)`` over the bins b of `reliability_curve`.

    Here the probability is P(occupied) over [0, 1]; the source uses the confidence of the winning
    class. So errors about free cells count as well.

    Parameters and errors are those of `reliability_curve`.

    Returns
    -------
    float
        In [0, 1]; NaN if no cell is sampled.

    References
    ----------
    Guo, Pleiss, Sun and Weinberger (2017), "On calibration of modern neural networks", Eq. 5.
    """
    curve = reliability_curve(probability, occupied, sampled, n_bins)
    filled = curve.counts > 0
    if not filled.any():
        return float("nan")
    gaps = np.abs(curve.occupied_fraction - curve.mean_predicted)[filled]
    return float(np.average(gaps, weights=curve.counts[filled]))


def observed_mask(sampled: ArrayLike, initially_sampled: ArrayLike) -> NDArray[np.bool_]:
    """Sampled voxels without those that are known from the start, such as the initial free space.

    That space, 11 m³ for each of two robots by default, is certain and right whatever a policy
    does. Counted in, it would make Brier score and log loss of two masts 6 % smaller after 16 scans
    and a quarter smaller after one scan, and more for more robots. The scores would then depend on
    the size of that space instead of the quality of the map.

    Parameters
    ----------
    sampled : array_like of bool
        `OccupancyMap.sampled` at the time of scoring.
    initially_sampled : array_like of bool
        The same before the first scan.

    Raises
    ------
    ValueError
        If the shapes differ, or a voxel is only sampled initially.
    """
    now, before = np.asarray(sampled, dtype=bool), np.asarray(initially_sampled, dtype=bool)
    if now.shape != before.shape:
        raise ValueError(
            f"sampled and initially_sampled must have one shape, got {now.shape}, {before.shape}"
        )
    if (before & ~now).any():
        raise ValueError("initially_sampled has voxels that are not in sampled; is it another map?")
    return np.asarray(now & ~before)


def _sampled_cells(
    probability: ArrayLike, occupied: ArrayLike, sampled: ArrayLike
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Probabilities and outcomes (0.0 or 1.0) of the sampled cells, both (N,)."""
    p = np.asarray(probability, dtype=np.float64)
    truth = np.asarray(occupied, dtype=bool)
    mask = np.asarray(sampled, dtype=bool)
    if not p.shape == truth.shape == mask.shape:
        raise ValueError(
            "probability, occupied and sampled must have one shape, "
            f"got {p.shape}, {truth.shape} and {mask.shape}"
        )
    p = p[mask]
    outside = ~((p >= 0) & (p <= 1))  # catches NaN as well
    if outside.any():
        raise ValueError(f"probability must lie in [0, 1], got {p[outside][0]} in a sampled cell")
    return p, truth[mask].astype(np.float64)


def _mean(values: NDArray[np.float64]) -> float:
    """Mean that is NaN for no values, without a warning."""
    return float(values.mean()) if values.size else float("nan")


def _ratio(totals: NDArray[Any], counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Totals over counts, NaN where nothing was counted."""
    return np.divide(totals, counts, out=np.full(counts.shape, np.nan), where=counts > 0)
