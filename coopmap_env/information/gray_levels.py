"""Gray levels of the new-information measure: Eqs. 8a and 8b, and their bins (Eq. 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.information.entropy import entropy_terms
from coopmap_env.information.settings import Interpretation, RatingSettings
from coopmap_env.mapping import LogOddsRange


def sampled_gray_level(
    probability: ArrayLike, distance: ArrayLike, interpretation: Interpretation = "distance_free"
) -> NDArray[np.float64]:
    """Eq. 8a: gray level in [0, 1] of sampled voxels.

    p < 1/2: p' = 1 / ((1 - p) d), p'' = (p' - 1) / 2, clamped to [0, 1/2];
    p >= 1/2: p' = 1 / (p d), p'' = 1 - (p' - 1) / 2, clamped to [1/2, 1].

    Parameters
    ----------
    probability : array_like
        P(occupied).
    distance : array_like
        From the camera, in voxels; below 1 counts as 1.
    interpretation : {"distance_free", "literal"}
        With d = 1 everywhere, or with the distance as printed.
    """
    p = np.asarray(probability, dtype=np.float64)
    d = np.ones_like(p) if interpretation == "distance_free" else np.maximum(distance, 1.0)
    free = np.clip((1.0 / (np.maximum(1.0 - p, 0.5) * d) - 1.0) / 2.0, 0.0, 0.5)
    occupied = np.clip(1.0 - (1.0 / (np.maximum(p, 0.5) * d) - 1.0) / 2.0, 0.5, 1.0)
    return np.where(p < 0.5, free, occupied)


def unknown_gray_level(distance: ArrayLike, depth: float) -> NDArray[np.float64]:
    """Eq. 8b: gray level in (1, 2] of never-sampled voxels; `depth` is d_max, the depth of field.

    The center of a voxel at the rim may lie a little beyond the depth of field; it counts as d_max.
    """
    return 1.0 + np.minimum(np.asarray(distance, dtype=np.float64) / depth, 1.0)


def gray_bin(gray: ArrayLike, n_gray_bins: int) -> NDArray[np.int64]:
    """Which of `n_gray_bins` uniform bins over [0, 2] each gray level falls into."""
    bins = (np.asarray(gray) * (n_gray_bins / 2)).astype(np.int64)
    return np.minimum(bins, n_gray_bins - 1)


class GrayBins(NamedTuple):
    """A `GrayLevelTable` as kernels take it, with the table of entropies of Eq. 6."""

    sampled: NDArray[np.uint8]
    """Bin of a sampled voxel, by its distance class and its log-odds plus the clamp."""
    distance_class: NDArray[np.uint8]
    unknown: NDArray[np.uint8]
    """Bin of a never-sampled voxel, by the index of its distance."""
    n_bins: int
    """Bins over the gray levels [0, 2]."""
    entropy_terms: NDArray[np.float64]
    """-q ln q by the count of a bin; see `entropy_terms`."""
    hidden_is_empty: bool
    """Whether voxels of N that a view does not count are empty; see `RatingSettings.hidden`."""


@borrowing_kernel
def histogram_entropy(counts: NDArray[np.int64], gray: GrayBins) -> float:
    """NI, nats, of the numbers of voxels (n_bins,) with each gray level in a view: Eqs. 6 and 7.

    Where hidden voxels count as empty, bin 0 becomes what the other bins leave of N, in `counts`
    too. In 3-D a view may hold a few voxels more than N: a bin with N or more has no entropy.
    """
    n = len(gray.entropy_terms) - 1
    if gray.hidden_is_empty:
        counts[0] = n
        for b in range(1, gray.n_bins):
            counts[0] -= counts[b]
        counts[0] = max(counts[0], 0)
    h = 0.0
    for b in range(gray.n_bins):
        h += gray.entropy_terms[min(counts[b], n)]
    return h


@dataclass(frozen=True)
class GrayLevelTable:
    """Eqs. 8a and 8b as tables: the bin of a voxel by its distance class and its log-odds.

    Eq. 8a, literally, depends on the distance only below two voxels: from there on
    1 / ((1 - p) d) <= 1 and the clamp decides. A few distance classes and the map's finite log-odds
    cover all cases. Without the distance there is one class.
    """

    sampled: NDArray[np.uint8]
    """Shape (classes, levels): bin of a sampled voxel; the last class is "two voxels or more"."""
    distance_class: NDArray[np.uint8]
    """Shape (k,): class of each distance."""
    unknown: NDArray[np.uint8]
    """Shape (k,): bin of a never-sampled voxel at each distance."""
    n_bins: int
    """Bins over the gray levels [0, 2]."""
    hidden_is_empty: bool
    """Whether voxels of N that a view does not count are empty."""

    @classmethod
    def from_distances(
        cls,
        distance: NDArray[np.float64],
        depth: float,
        settings: RatingSettings,
        log_odds_range: LogOddsRange,
    ) -> GrayLevelTable:
        """Tables for cells at these distances (voxels) from the camera."""
        n_gray_bins, interpretation = settings.n_gray_bins, settings.interpretation
        has_near_classes = interpretation == "literal"
        near = np.unique(np.maximum(distance[(distance < 2.0) & has_near_classes], 1.0))
        bounded = np.maximum(distance, 1.0)
        classes = np.minimum(np.searchsorted(near, bounded), len(near))
        rows = [
            gray_bin(sampled_gray_level(log_odds_range.probability, d, interpretation), n_gray_bins)
            for d in (*near, 2.0)
        ]
        return cls(
            np.array(rows, dtype=np.uint8),
            classes.astype(np.uint8),
            gray_bin(unknown_gray_level(distance, depth), n_gray_bins).astype(np.uint8),
            n_gray_bins,
            settings.hidden == "empty",
        )

    def arrays(self, max_visible_cells: int) -> GrayBins:
        """Tables for kernels; `max_visible_cells` is N of Eq. 7."""
        return GrayBins(
            self.sampled,
            self.distance_class,
            self.unknown,
            self.n_bins,
            entropy_terms(max_visible_cells),
            self.hidden_is_empty,
        )
