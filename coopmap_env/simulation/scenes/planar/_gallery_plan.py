"""How corridors join the places of a lattice: which of them, and where the lattice's bands lie.

A place of the lattice is a pair (column, row). The world's sides are cut into bands, one for each
column and each row, with walls in between. What is dug for a column or a row stays in its band, so
two places are joined only if the plan joins them.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Place = tuple[int, int]
Join = tuple[Place, Place]

_NEWEST_FRACTION = 0.5
"""Chance that the tree grows on from its newest place rather than from any: long corridors that
wind, with a side branch here and there."""
_STRAIGHT_FRACTION = 0.5
"""Chance that a corridor goes straight on where it can."""
_WEIGHTS = (0.1, 1.0)
"""Least and greatest weight by which a band gets its part of the cells that are left over."""


class Bands(NamedTuple):
    """Where bands lie, in cells: those of one axis (n,), or both of each of n places (n, 2)."""

    starts: NDArray[np.int64]
    """First cell."""
    stops: NDArray[np.int64]
    """Cell after the last one."""


def cut_bands(
    rng: np.random.Generator, n_cells: int, n_bands: int, thinnest: int, wall: int
) -> Bands:
    """Cut a side of `n_cells` into bands of at least `thinnest` cells, with walls around each."""
    spare = n_cells - wall - n_bands * (thinnest + wall)
    low, high = _WEIGHTS
    weights = np.cumsum(low + (high - low) * rng.random(n_bands))
    stops = (spare * weights / weights[-1]).astype(np.int64)
    stops += (thinnest + wall) * np.arange(1, n_bands + 1)
    starts = np.concatenate([[0], stops[:-1]]) + wall
    return Bands(starts, stops)


def grow_tree(rng: np.random.Generator, shape: tuple[int, int]) -> list[Join]:
    """Join all places of a lattice by a random spanning tree ("growing tree" algorithm)."""
    first = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
    reached, joins, growing = {first}, [], [(first, first)]
    while growing:
        newest = rng.random() < _NEWEST_FRACTION
        chosen = len(growing) - 1 if newest else int(rng.integers(len(growing)))
        before, place = growing[chosen]
        free = [other for other in _neighbors(place, shape) if other not in reached]
        if not free:
            del growing[chosen]
            continue
        ahead = 2 * place[0] - before[0], 2 * place[1] - before[1]
        straight = ahead in free and rng.random() < _STRAIGHT_FRACTION
        other = ahead if straight else free[int(rng.integers(len(free)))]
        reached.add(other)
        joins.append((place, other))
        growing.append((place, other))
    return joins


def join_dead_ends(
    rng: np.random.Generator, joins: list[Join], shape: tuple[int, int], kept: float
) -> list[Join]:
    """Joins by which dead ends become loops, but for a fraction `kept` of them by chance."""
    joined: dict[Place, set[Place]] = {}
    for a, b in joins:
        joined.setdefault(a, set()).add(b)
        joined.setdefault(b, set()).add(a)
    added = []
    for place in sorted(joined):
        if len(joined[place]) > 1 or rng.random() < kept:
            continue
        others = [other for other in _neighbors(place, shape) if other not in joined[place]]
        if others:
            other = others[int(rng.integers(len(others)))]
            joined[place].add(other)
            joined[other].add(place)
            added.append((place, other))
    return added


def _neighbors(place: Place, shape: tuple[int, int]) -> Iterator[Place]:
    """Places beside a place in the lattice."""
    x, y = place
    for other in ((x - 1, y), (x + 1, y), (x, y - 1), (x, y + 1)):
        if 0 <= other[0] < shape[0] and 0 <= other[1] < shape[1]:
            yield other
