"""Checked samples: numbers by world, and tables of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray


def check_per_world(values: ArrayLike, name: str, min_size: int = 2) -> NDArray[np.float64]:
    """Check a sample of one finite number per world, as a (n_worlds,) array."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 1:
        raise ValueError(f"{name} must have one axis (n_worlds,), got shape {array.shape}")
    if array.size < min_size:
        raise ValueError(f"{name} needs at least {min_size} worlds, got {array.size}")
    check_finite(array, name)
    return array


def check_paired(a: ArrayLike, b: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Check two samples of the same worlds, as (n_worlds,) arrays."""
    first, second = check_per_world(a, "a"), check_per_world(b, "b")
    if first.shape != second.shape:
        raise ValueError(
            f"a and b must cover the same worlds, got {first.size} and {second.size} of them"
        )
    return first, second


def check_table(values: ArrayLike, name: str, min_columns: int) -> NDArray[np.float64]:
    """Check a finite table with a row per world, as a (n_worlds, k) array."""
    array = np.asarray(values, dtype=np.float64)
    if array.ndim != 2:
        raise ValueError(f"{name} must have two axes (n_worlds, k), got shape {array.shape}")
    if array.shape[0] < 2:
        raise ValueError(f"{name} needs at least 2 worlds (rows), got {array.shape[0]}")
    if array.shape[1] < min_columns:
        raise ValueError(f"{name} needs at least {min_columns} columns, got {array.shape[1]}")
    check_finite(array, name)
    return array


def check_finite(array: NDArray[np.float64], name: str) -> None:
    """Raise a ValueError with the index of the first value that is not finite."""
    bad = np.argwhere(~np.isfinite(array))
    if bad.size:
        index = tuple(int(i) for i in bad[0])
        index_text = ", ".join(map(str, index))
        raise ValueError(f"{name}[{index_text}] is {array[index]}, every value must be finite")
