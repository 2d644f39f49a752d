"""Gray levels of the new-information measure: Eqs. 8a and 8b, and their bins (Eq. 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import entropy_terms
from coopmap_env.mapping import LogOddsRange

Interpretation = Literal["literal", "distance_free"]


def sampled_gray_level(
    probability: ArrayLike, distance: ArrayLike, interpretation: Interpretation = "literal"
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
    interpretation : {"literal", "distance_free"}
        With the distance as printed, or with d = 1 everywhere.
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


@dataclass(frozen=True)
class GrayLevelTable:
    """Eqs. 8a and 8b as tables: the bin of a voxel by its distance class and its log-odds.

    Eq. 8a depends on the distance only below two voxels: from there on 1 / ((1 - p) d) <= 1 and
    the clamp decides. A few distance classes and the map's finite log-odds cover all cases.
    """

    sampled: NDArray[np.uint8]
    """Shape (classes, levels): bin of a sampled voxel; the last class is "two voxels or more"."""
    distance_class: NDArray[np.uint8]
    """Shape (k,): class of each distance."""
    unknown: NDArray[np.uint8]
    """Shape (k,): bin of a never-sampled voxel at each distance."""
    n_bins: int
    """Bins over the gray levels [0, 2]."""

    @classmethod
    def from_distances(
        cls,
        distance: NDArray[np.float64],
        depth: float,
        n_gray_bins: int,
        interpretation: Interpretation,
        log_odds_range: LogOddsRange,
    ) -> GrayLevelTable:
        """Tables for cells at these distances (voxels) from the camera."""
        near = np.unique(np.maximum(distance[distance < 2.0], 1.0))
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
        )

    def arrays(self, max_visible_cells: int) -> GrayBins:
        """Tables for kernels; `max_visible_cells` is N of Eq. 7."""
        return GrayBins(
            self.sampled,
            self.distance_class,
            self.unknown,
            self.n_bins,
            entropy_terms(max_visible_cells),
        )
