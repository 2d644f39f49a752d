"""Shannon entropy (Eq. 6)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import log_array


def entropy(q: ArrayLike) -> float:
    """H(q) = - sum of q_k ln q_k, nats (Eq. 6); events of zero probability change nothing.

    The q need not sum to one: as printed, Eq. 7 leaves out what an occluder hides.

    Raises
    ------
    ValueError
        If a value lies outside [0, 1].
    """
    q = np.asarray(q, dtype=np.float64)
    if not ((q >= 0) & (q <= 1)).all():
        raise ValueError(f"probabilities must lie in [0, 1], got {q}")
    return float(-np.sum(q * log_array(np.where(q > 0, q, 1.0))))


def entropy_terms(n: int) -> NDArray[np.float64]:
    """-q ln q of q = f / n for every count f = 0 ... n, shape (n + 1,)."""
    q = np.arange(n + 1) / n
    return -q * log_array(np.where(q > 0, q, 1.0))
