"""Which voxels the proper scores of a field map ask about."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def observed_mask(sampled: ArrayLike, initially_sampled: ArrayLike) -> NDArray[np.bool_]:
    """Sampled voxels but for those known from the start, such as a vehicle's parking room.

    That room, two times 11 m³ by default, is certain and right whatever a policy does. Counted in,
    it makes Brier score and log loss of two masts 6 % smaller after 16 scans and a quarter smaller
    after one, more for more vehicles, and so tells how wide the room is, not how good the map is.

    Parameters
    ----------
    sampled : array_like of bool
        `OccupancyMap.sampled` at the time of scoring.
    initially_sampled : array_like of bool
        The same before the first scan.

    Raises
    ------
    ValueError
        If the shapes differ, or the map has forgotten what it knew.
    """
    now, before = np.asarray(sampled, dtype=bool), np.asarray(initially_sampled, dtype=bool)
    if now.shape != before.shape:
        raise ValueError(
            f"sampled and initially_sampled must have one shape, got {now.shape}, {before.shape}"
        )
    if (before & ~now).any():
        raise ValueError(
            "initially_sampled must be of the same map before the first scan: it has more voxels"
        )
    return np.asarray(now & ~before)
