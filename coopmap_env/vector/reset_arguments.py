"""The arguments of `reset`: a seed for each world, and which worlds."""

from __future__ import annotations

import operator
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief


def parse_seeds(seed: Any, n_worlds: int) -> list[int | None]:
    """A seed for each world.

    Raises
    ------
    ValueError
        Naming the world and the value.
    """
    if seed is None:
        return [None] * n_worlds
    is_array = isinstance(seed, np.ndarray) and seed.ndim > 0
    if is_array or (isinstance(seed, Sequence) and not isinstance(seed, str | bytes)):
        if len(seed) != n_worlds:
            raise ValueError(f"{n_worlds} worlds need as many seeds, got {len(seed)}")
        return [None if own is None else _parse_seed(own, world) for world, own in enumerate(seed)]
    first = _parse_seed(seed, 0)
    return [first + world for world in range(n_worlds)]


def parse_reset_mask(mask: Any, n_worlds: int, rows_per_world: int) -> NDArray[np.bool_]:
    """Worlds to reset, from a mask of rows; None resets all.

    Raises
    ------
    ValueError
        If the mask is of another type or shape, or rows of a world differ.
    """
    if mask is None:
        return np.ones(n_worlds, dtype=bool)
    values, n_rows = np.asarray(mask), n_worlds * rows_per_world
    if values.dtype != bool or values.shape != (n_rows,):
        raise ValueError(f"reset_mask must be a bool array of shape ({n_rows},), got {brief(mask)}")
    by_world = values.reshape(n_worlds, rows_per_world)
    differing = np.flatnonzero((by_world != by_world[:, :1]).any(axis=1))
    if len(differing):
        raise ValueError(
            f"the rows of a world are reset together, got {by_world[differing[0]].tolist()} for "
            f"those of world {differing[0]}"
        )
    return by_world[:, 0].copy()


def _parse_seed(seed: Any, world: int) -> int:
    try:
        number = operator.index(seed)
    except Exception:  # a TypeError, or what an object's `__index__` raises
        number = -1
    if number < 0 or isinstance(seed, bool | np.bool_):
        raise ValueError(
            f"the seed of world {world} must be an integer of at least 0, got {brief(seed)}"
        )
    return number
