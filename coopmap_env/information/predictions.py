"""Predicted occupancy of the cells of a map, from whatever predicts it."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def checked_probabilities(values: ArrayLike, n_cells: int) -> NDArray[np.float32]:
    """Predictions as float32 (n_cells,).

    Raises
    ------
    ValueError
        If they are not one probability for each cell.
    """
    found = np.ascontiguousarray(values, dtype=np.float32)
    if found.shape != (n_cells,):
        raise ValueError(
            f"unknown_occupancy must have one value for each of {n_cells} cells, got an array of "
            f"shape {found.shape}"
        )
    if not (found.min() >= 0 and found.max() <= 1):  # so that NaN is refused too
        raise ValueError(
            f"unknown_occupancy must be probabilities from 0 to 1, got {found.min()} to "
            f"{found.max()}"
        )
    return found
