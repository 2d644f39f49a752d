"""What the mutual information of planar and of depth cameras has in common: the model of a cell.

For a beam without noise the measurement is the first occupied cell, a function of the map; so the
mutual information equals the measurement's entropy, and by the chain rule

    I(map; beam) = sum over cells k of v_k H(p_k),   v_k = product of 1 - p_j over cells j before k

with H the entropy of a cell (Eq. 6 of its two outcomes): the entropy of the cells, weighted by the
probability that the beam gets there. This is the noise-free case of the beam-based mutual
information of Julian, Karaman & Rus 2014 ("On mutual information-based control of range sensing
robots for mapping applications").
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.information.entropy import entropy
from coopmap_env.mapping import LogOddsRange

MIN_REACH_PROBABILITY = 1e-3
"""A beam is followed until the probability that it gets so far falls below this."""


class CellModel(NamedTuple):
    """Occupancy and entropy that kernels of mutual information expect of a cell."""

    occupancy: NDArray[np.float64]
    """P(occupied) of a sampled cell, by its log-odds in fixed point plus the clamp."""
    entropy: NDArray[np.float64]
    """Entropy of a sampled cell, nats, by the same index."""
    prior: float
    """Occupancy of a never-sampled cell."""
    prior_entropy: float
    """Entropy of a never-sampled cell, nats."""
    known_entropy: float
    """Entropy of a cell that is as good as known, nats: this part of an entropy does not count."""

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
