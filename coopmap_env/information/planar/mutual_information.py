"""Mutual information between a map and the beams of a planar camera.

The chain rule of `information.mutual_information`, beam by beam. The beams of one scan share cells;
beams are treated as independent, except that a cell counts once, with the beam that most probably
reaches it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import kernel
from coopmap_env.information._mutual_information import (
    MIN_REACH_PROBABILITY,
    CellModel,
    validate_prior,
)
from coopmap_env.information.planar.rating import PlanarRatingFunction
from coopmap_env.information.ratings import WHOLE_VIEW, ViewContext
from coopmap_env.mapping import MapArrays, OccupancyMap
from coopmap_env.sensing import BeamFan
from coopmap_env.sensing.beam_fan import BEAMS_PER_WORD, FanArrays


class BeamEntries(NamedTuple):
    """For each heading and beam the fan entries that it crosses, nearest first.

    Those of heading h and beam b are ``entries[start[h, b] : start[h, b + 1]]``.
    """

    start: NDArray[np.int64]
    """Shape (n_headings, n_beams + 1)."""
    entries: NDArray[np.int32]
    order: NDArray[np.int32]
    """All entries, heading by heading, in the order of the sum: by |dx| + |dy|, then dx and dy."""

    @classmethod
    def from_fan(cls, fan: BeamFan) -> BeamEntries:
        """List the fan entries of every beam."""
        n_beams = sum(int(word).bit_count() for word in fan.all_beams)
        start = np.zeros((fan.n_headings, n_beams + 1), dtype=np.int64)
        parts = []
        total = 0
        for h in range(fan.n_headings):
            low, high = fan.start[h], fan.start[h + 1]
            for beam in range(n_beams):
                word, bit = divmod(beam, BEAMS_PER_WORD)
                crossed = fan.beams[word, low:high] >> np.uint64(bit) & np.uint64(1)
                (entries,) = np.nonzero(crossed)
                start[h, beam] = total
                total += len(entries)
                parts.append(entries + low)
            start[h, n_beams] = total
        heading = np.repeat(np.arange(fan.n_headings), np.diff(fan.start))
        dx, dy = fan.offsets.T.astype(np.int32)
        order = np.lexsort((dy, dx, np.abs(dx) + np.abs(dy), heading))
        return cls(start, np.concatenate(parts).astype(np.int32), order.astype(np.int32))


class PlanarMutualInformation:
    """Mutual information of lattice poses.

    Parameters
    ----------
    rating : PlanarRatingFunction
        Holds the lattice and the camera's fan.
    prior : float
        Occupancy expected of cells that were never sampled. The map's own is one half, through
        which a beam gets no further than two or three cells.
    known_probability : float
        Occupancy, or one minus it, at which a cell is as good as known: its entropy does not count,
        nor does that part of the entropy of other cells. 1 takes entropies as they are.

    Raises
    ------
    ValueError
        If `prior` does not lie in (0, 1), or `known_probability` not in (0.5, 1].
    """

    def __init__(
        self, rating: PlanarRatingFunction, prior: float = 0.5, known_probability: float = 1.0
    ) -> None:
        validate_prior(prior, known_probability)
        self._prior, self._known_probability = float(prior), known_probability
        self._rating = rating
        self._beams = BeamEntries.from_fan(rating.fan)

    def mutual_information(
        self, map_: OccupancyMap, poses: ArrayLike, context: ViewContext = WHOLE_VIEW
    ) -> NDArray[np.float64]:
        """Nats, shape (k,), of lattice poses; the arguments are those of `PlanarRatingFunction`."""
        ids = self._rating.validate_ids(map_, poses)
        out = np.empty(len(ids))
        model = CellModel.of_map(map_.log_odds_range, self._prior, self._known_probability)
        reserved = context.reserved_mask
        if reserved is None:
            reserved = np.zeros(map_.grid.n_cells, dtype=np.uint8)
        write_mutual_information(
            map_.arrays,
            reserved,
            ids,
            self._rating.fan.arrays(map_.grid.shape[1]),
            self._beams,
            model,
            out,
        )
        return out


@kernel
def write_mutual_information(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan: FanArrays,
    beams: BeamEntries,
    model: CellModel,
    out: NDArray[np.float64],
) -> None:
    """Write the sum of v_k H(p_k) over each pose's fan, v_k of the likeliest beam."""
    log_odds_fixed, sampled, (nx, ny, _) = arrays.log_odds_fixed, arrays.sampled_mask, arrays.shape
    offsets, start, entries, clamp = fan.offsets, beams.start, beams.entries, arrays.clamp
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
                    model.occupancy[log_odds_fixed[at] + clamp] if sampled[at] else model.prior
                )
                if reach_probability < MIN_REACH_PROBABILITY:
                    break
        total = 0.0
        for e in range(fan.start[heading], fan.start[heading + 1]):
            k = beams.order[e]
            if reached[k] > 0.0:
                at = (x + offsets[k, 0]) * ny + y + offsets[k, 1]
                if not reserved_mask[at]:
                    h = (
                        model.entropy[log_odds_fixed[at] + clamp]
                        if sampled[at]
                        else model.prior_entropy
                    )
                    total += reached[k] * max(h - model.known_entropy, 0.0)
                reached[k] = 0.0
        out[p] = total
