"""Maps of a team with the true world behind them: what a network learns to predict from."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation, distance_transform_cdt

from coopmap_agents.map_prediction.images import KNOWN_SCALE, UNKNOWN, map_image
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation import Policy, rollout

NEAR_CELLS = 12.0
"""Cells over which the weight of an unknown cell falls by a factor of e with its distance from
known free ones, from where the next views will look at it."""


class MapExamples(NamedTuple):
    """Maps of one world size, each with the truth; arrays (n, nx, ny) or (n, nx, ny, nz)."""

    images: NDArray[np.uint8]
    """See `map_image`."""
    occupied: NDArray[np.bool_]
    """What is predicted; see `predicted_cells`."""
    weights: NDArray[np.float32]
    """How much a cell counts: 0 if it is known; see `cell_weights`."""


def predicted_cells(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """What a network is to predict of the true world: of a planar one, the occupied cells.

    In 3-D, surface alone: occupied voxels with a free neighbour. There, views are expected to
    show what they would if unknown voxels were free, so the inside of solids has to count as none.
    """
    return occupied & _beside_free(occupied) if occupied.ndim == 3 else occupied.copy()


def _beside_free(occupied: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Which cells are free or have a free neighbour, diagonal ones too."""
    neighbours = np.ones((3,) * occupied.ndim, dtype=bool)
    beside: NDArray[np.bool_] = binary_dilation(~occupied, neighbours)
    return beside


def cell_weights(image: NDArray[np.uint8], occupied: NDArray[np.bool_]) -> NDArray[np.float32]:
    """Weights of the cells of an image: exp(-d / `NEAR_CELLS`), and 0 if known or out of sight.

    d is the distance to the nearest cell that is known to be free, by the longest of dx, dy and dz,
    in cells. Out of sight are cells of `occupied` without a neighbour that is not: no beam ends
    there. Of `predicted_cells` in 3-D there are none. So a planar network learns the fraction of
    surfaces among the cells that beams get to, which is what they need: the fraction of all
    occupied cells is far larger where obstacles are thick.
    """
    counts = (image == UNKNOWN) & _beside_free(occupied)
    free = image < KNOWN_SCALE / 2
    if not free.any():
        return counts.astype(np.float32)
    steps = distance_transform_cdt(~free, "chessboard")
    return (np.exp(-steps / NEAR_CELLS) * counts).astype(np.float32)


def collect_examples(
    env: MappingEnv[Any], policies: Sequence[Policy], seeds: Sequence[int], n_maps: int
) -> MapExamples:
    """Let policies play, and keep the map before some of the scans of each episode.

    Parameters
    ----------
    env : MappingEnv
        Its worlds have one size.
    policies : sequence of Policy
        They take turns from episode to episode.
    seeds : sequence of int
        Of the worlds; they also decide which maps are kept.
    n_maps : int
        Maps of each episode, drawn from its scans; all if it has fewer.

    Raises
    ------
    ValueError
        If there is none to keep.
    """
    images, occupied = [], []
    for number, seed in enumerate(seeds):
        policy = policies[number % len(policies)]
        played = [map_image(step.belief.map) for step in rollout(env, policy, seed)]
        for scan in np.random.default_rng(seed).permutation(len(played))[:n_maps]:
            images.append(played[scan])
            occupied.append(predicted_cells(env.truth.occupied))
    if not images or n_maps < 1:
        raise ValueError("examples need seeds of episodes, and one map of each at least")
    weights = [cell_weights(*example) for example in zip(images, occupied, strict=True)]
    return MapExamples(np.stack(images), np.stack(occupied), np.stack(weights))
