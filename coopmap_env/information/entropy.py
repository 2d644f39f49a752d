"""Shannon entropy (Eq. 6), and what both mutual informations expect of a cell."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.mapping import LogOddsRange

MIN_REACH_PROBABILITY = 1e-3
"""A beam is followed until the probability that it gets so far falls below this."""


def entropy(q: ArrayLike) -> float:
    """H(q) = - sum of q_k ln q_k, nats (Eq. 6); events of zero probability change nothing.

    The q need not sum to one: what an occluder hides is missing (Eq. 7).

    Raises
    ------
    ValueError
        If a value lies outside [0, 1].
    """
    q = np.asarray(q, dtype=np.float64)
    if not ((q >= 0) & (q <= 1)).all():
        raise ValueError(f"probabilities must lie in [0, 1], got {q}")
    return float(-np.sum(q * np.log(np.where(q > 0, q, 1.0))))


def entropy_terms(n: int) -> NDArray[np.float64]:
    """-q ln q of q = f / n for every count f = 0 ... n, shape (n + 1,)."""
    q = np.arange(n + 1) / n
    return -q * np.log(np.where(q > 0, q, 1.0))


class CellModel(NamedTuple):
    """Occupancy and entropy that kernels of mutual information expect of a cell."""

    occupancy: NDArray[np.float64]
    """Of a sampled cell, by its log-odds in fixed point plus the clamp."""
    entropy: NDArray[np.float64]
    """Nats, of a sampled cell, by the same index."""
    prior: float
    """Occupancy of a never-sampled cell."""
    prior_entropy: float
    """Nats, of a never-sampled cell."""
    known_entropy: float
    """Nats, of a cell that is as good as known: the part of an entropy that does not count."""

    @classmethod
    def of_map(
        cls, log_odds_range: LogOddsRange, prior: float, known_probability: float
    ) -> CellModel:
        """Tables of a map's log-odds; see `PlanarMutualInformation` for the other arguments."""
        return cls(
            log_odds_range.probability,
            log_odds_range.entropy,
            prior,
            entropy([prior, 1.0 - prior]),
            entropy([known_probability, 1.0 - known_probability]),
        )


def validate_prior(prior: float, known_probability: float) -> None:
    """Check the constants of a mutual information.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `known_probability` not in (0.5, 1].
    """
    if not 0 < prior < 1:
        raise ValueError(f"prior must lie in (0, 1), got {prior!r}")
    if not 0.5 < known_probability <= 1:
        raise ValueError(f"known_probability must lie in (0.5, 1], got {known_probability!r}")
