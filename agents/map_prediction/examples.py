"""Maps of a team with the true world behind them: what a network learns to predict from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_cdt

from coopmap_agents.map_prediction.network import KNOWN_SCALE, UNKNOWN
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Policy, rollout
from coopmap_env.mapping import OccupancyMap

NEAR_CELLS = 12.0
"""Cells over which the weight of an unknown cell falls by a factor of e with its distance from
known free ones, from where the next views will look at it."""


class MapExamples(NamedTuple):
    """Maps of one world size, each with the truth; arrays of shape (n, nx, ny)."""

    images: NDArray[np.uint8]
    """See `map_image`."""
    occupied: NDArray[np.bool_]
    """The true world."""
    weights: NDArray[np.float32]
    """How much a cell counts: 0 if it is known; see `cell_weights`."""


def map_image(map_: OccupancyMap) -> NDArray[np.uint8]:
    """The map as bytes, in the shape of its grid: 255 if never sampled, else 254 P, rounded."""
    p_by_log_odds = np.round(KNOWN_SCALE * map_.log_odds_range.probability).astype(np.uint8)
    image = p_by_log_odds[map_.log_odds_fixed + map_.log_odds_range.clamp]
    image[map_.sampled_mask == 0] = UNKNOWN
    return image.reshape(map_.grid.shape)


def cell_weights(image: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Weights of the cells of an image: 0 if known, else exp(-d / `NEAR_CELLS`).

    d is the distance to the nearest cell that is known to be free, by the longer of dx and dy, in
    cells.
    """
    free = image < KNOWN_SCALE / 2
    if not free.any():
        return (image == UNKNOWN).astype(np.float32)
    steps = distance_transform_cdt(~free, "chessboard")
    return (np.exp(-steps / NEAR_CELLS) * (image == UNKNOWN)).astype(np.float32)


def collect_examples(
    env: PlanarEnv, policies: Sequence[Policy], seeds: Sequence[int], n_maps: int
) -> MapExamples:
    """Let policies play, and keep the map before some of the scans of each episode.

    Parameters
    ----------
    env : PlanarEnv
        Its worlds have one size.
    policies : sequence of Policy
        They take turns from episode to episode.
    seeds : sequence of int
        Of the worlds; they also decide which maps are kept.
    n_maps : int
        Maps of each episode, at most: fewer where time ends it.

    Raises
    ------
    ValueError
        If no map was kept.
    """
    images, occupied = [], []
    for number, seed in enumerate(seeds):
        policy = policies[number % len(policies)]
        scans = range(env.max_scans)
        kept = set(np.random.default_rng(seed).permutation(scans)[:n_maps].tolist())
        for scan, step in enumerate(rollout(env, policy, seed)):
            if scan in kept:
                images.append(map_image(step.belief.map))
                occupied.append(env.truth.occupied.copy())
    if not images:
        raise ValueError(
            f"none of the scans whose maps were to be kept was played in {len(seeds)} episodes: "
            "take more maps of each, or more episodes"
        )
    weights = [cell_weights(image) for image in images]
    return MapExamples(np.stack(images), np.stack(occupied), np.stack(weights))
