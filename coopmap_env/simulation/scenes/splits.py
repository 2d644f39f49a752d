"""Frozen splits: worlds to train on, to choose settings by and to report on never overlap.

A generated world is named by a split and a seed. The split enters the spawn key of the
`numpy.random.SeedSequence`, apart from the seed, so

- seed 7 of ``train`` and seed 7 of ``test`` are unrelated streams, whatever the seeds: no ranges
  of seeds have to be kept apart, and no split can run out of seeds;
- worlds of a split never change: ``test`` with seeds 0 to 99 is the same set in each paper;
- the key starts with a number of our own, because the n-th child of ``SeedSequence(7)`` has the
  spawn key ``(n,)``: without it, an environment that spawns its streams from a plain seed would
  draw its first one from the very stream of a split.

The order of `SPLITS` is part of the promise: a new split goes to its end.
"""

import operator
from typing import TypedDict

import numpy as np

from coopmap_env.core.files import brief

SPLITS = ("train", "validation", "test")
"""Train on the first, choose settings on the second, report the third once."""

_NAMESPACE = 0x5CE2E
"""First word of each spawn key: far above any number of children that somebody spawns."""


class WorldSeedWords(TypedDict):
    """What a seed sequence is made of."""

    entropy: int
    spawn_key: tuple[int, ...]


def world_seed(split: str, seed: int) -> np.random.SeedSequence:
    """Seed sequence of one world of a split.

    Parameters
    ----------
    split : str
        One of `SPLITS`.
    seed : int
        Number of the world in its split, 0 or more.

    Returns
    -------
    numpy.random.SeedSequence
        For ``numpy.random.default_rng``; spawn children of it for more than one purpose.

    Raises
    ------
    ValueError
        With the value, if the split is unknown or the seed is no integer of at least 0.
    """
    return np.random.SeedSequence(**world_seed_words(split, seed))


def world_seed_words(split: str, seed: int) -> WorldSeedWords:
    """The arguments of `numpy.random.SeedSequence` for a world; see `world_seed`.

    Raises
    ------
    ValueError
        Like `world_seed`.
    """
    if split not in SPLITS:
        raise ValueError(f"split must be one of {', '.join(SPLITS)}, not {brief(split)}")
    return {"entropy": _check_seed(seed), "spawn_key": (_NAMESPACE, SPLITS.index(split))}


def _check_seed(seed: int) -> int:
    try:
        number = operator.index(seed)
    except Exception:  # a TypeError, or what an object's `__index__` raises
        number = -1
    if number < 0 or isinstance(seed, bool | np.bool_):
        raise ValueError(f"seed must be an integer of at least 0, not {brief(seed)}")
    return number
