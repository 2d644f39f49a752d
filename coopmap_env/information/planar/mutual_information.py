"""Mutual information between a map and the beams of a pose in the plane.

For a beam without noise the reading is the first occupied cell, a function of the map; so the
mutual information equals the reading's entropy, and by the chain rule

    I(map; beam) = sum over cells k of v_k H(p_k),   v_k = product of 1 - p_j over cells j before k

with H the entropy of a cell (Eq. 6 of its two outcomes): the entropy of the cells, weighted by the
chance that the beam gets there. This is the noise-free case of the beam-based mutual information of
Julian, Karaman & Rus 2014 ("On mutual information-based control of range sensing robots for mapping
applications"). The beams of one look share cells; as they do there, beams are treated as
independent, except that a cell counts once, with the beam that most probably reaches it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import entropy
from coopmap_env.information.planar.fan import BEAMS_PER_WORD, BeamFan
from coopmap_env.information.planar.rating import RatingFunction
from coopmap_env.mapping import OccupancyMap

MIN_REACH_PROBABILITY = 1e-3
"""A beam that gets no further than with this probability is not followed."""


def validate_prior(prior: float, known_probability: float) -> tuple[float, float]:
    """The prior, and the entropy that counts for nothing; see `MutualInformation`."""
    if not 0 < prior < 1:
        raise ValueError(f"prior must lie in (0, 1), got {prior!r}")
    if not 0.5 < known_probability <= 1:
        raise ValueError(f"known_probability must lie in (0.5, 1], got {known_probability!r}")
    return float(prior), entropy([known_probability, 1.0 - known_probability])


class MutualInformation:
    """Mutual information of lattice poses.

    Parameters
    ----------
    rating : RatingFunction
        Holds the lattice and the camera's fan.
    prior : float
        Occupancy expected of cells that were never sampled. The map's own is one half, through
        which a beam gets no further than two or three cells.
    known : float
        Occupancy, or one minus it, at which a cell is as good as known: its entropy counts for
        nothing, that of other cells above it. 1 takes entropies as they are.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `known_probability` not in (0.5, 1].
    """

    def __init__(
        self, rating: RatingFunction, prior: float = 0.5, known_probability: float = 1.0
    ) -> None:
        self._prior, self._known_entropy = validate_prior(prior, known_probability)
        self._rating = rating
        self._fan = rating.fan
        self._start, self._entries = _entries_of_beams(rating.fan)
        self._no_reservation = np.zeros(rating.lattice.grid.n_cells, dtype=np.uint8)

    def mutual_information(
        self, map_: OccupancyMap, ids: ArrayLike, reserved_mask: NDArray[np.uint8] | None = None
    ) -> NDArray[np.float64]:
        """Nats, shape (k,), of lattice poses `ids` (k,); `reserved_mask` cells are left out."""
        ids = self._rating.validate_ids(map_, ids)
        out = np.empty(len(ids))
        nx, ny = map_.grid.shape
        mutual_information(
            map_.log_odds_fixed, map_.sampled_mask, self._no_reservation if reserved_mask is None else reserved_mask,
            nx, ny, ids, self._fan.start, self._fan.offsets, self._start, self._entries,
            map_.log_odds_range.probability, map_.log_odds_range.entropy, map_.log_odds_range.clamp,
            self._prior, entropy([self._prior, 1.0 - self._prior]), self._known_entropy, out,
        )  # fmt: skip
        return out


def _entries_of_beams(fan: BeamFan) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """For each heading and beam the fan entries that it crosses, in order.

    Those of heading h and beam b are `entries[start[h, b] : start[h, b + 1]]`.
    """
    n_beams = sum(int(word).bit_count() for word in fan.all_beams)
    start = np.zeros((fan.n_headings, n_beams + 1), dtype=np.int64)
    parts = []
    total = 0
    for h in range(fan.n_headings):
        low, high = fan.start[h], fan.start[h + 1]
        for beam in range(n_beams):
            word, bit = divmod(beam, BEAMS_PER_WORD)
            crossed = fan.beams[low:high, word] >> np.uint64(bit) & np.uint64(1)
            (entries,) = np.nonzero(crossed)
            start[h, beam] = total
            total += len(entries)
            parts.append(entries + low)
        start[h, n_beams] = total
    return start, np.concatenate(parts).astype(np.int32)


@njit(cache=True, nogil=True)
def mutual_information(
    log_odds_fixed, sampled, reserved_mask, nx, ny, poses, fan_start, offsets, start, entries,
    probability, entropy, clamp, prior, prior_entropy, known_entropy, out,
):  # fmt: skip
    """Sum of v_k H(p_k) over the cells of each pose's fan, v_k of the luckiest beam."""
    n_headings, n_beams = start.shape[0], start.shape[1] - 1
    reached = np.zeros(len(offsets))
    for p in range(len(poses)):
        cell, heading = poses[p] // n_headings, poses[p] % n_headings
        x, y = cell // ny, cell % ny
        for beam in range(n_beams):
            reach_probability = 1.0
            for e in range(start[heading, beam], start[heading, beam + 1]):
                k = entries[e]
                i, j = x + offsets[k, 0], y + offsets[k, 1]
                if i < 0 or i >= nx or j < 0 or j >= ny:
                    break
                reached[k] = max(reached[k], reach_probability)
                at = i * ny + j
                reach_probability *= 1.0 - (
                    probability[log_odds_fixed[at] + clamp] if sampled[at] else prior
                )
                if reach_probability < MIN_REACH_PROBABILITY:
                    break
        total = 0.0
        for k in range(fan_start[heading], fan_start[heading + 1]):
            if reached[k] > 0.0:
                at = (x + offsets[k, 0]) * ny + y + offsets[k, 1]
                if not reserved_mask[at]:
                    h = entropy[log_odds_fixed[at] + clamp] if sampled[at] else prior_entropy
                    total += reached[k] * max(h - known_entropy, 0.0)
                reached[k] = 0.0
        out[p] = total
