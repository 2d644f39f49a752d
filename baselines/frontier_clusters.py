"""Clusters of frontier cells, and which poses belong to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from coopmap_env.envs import Belief, Poses


def cluster_labels(belief: Belief, robot: int, min_cells: int) -> NDArray[np.int32]:
    """Clusters of the frontier cells of a robot's map: connected ones, also by edges and corners.

    Parameters
    ----------
    belief : Belief
    robot : int
    min_cells : int
        Smaller clusters are dropped: mostly they are gaps between two beams.

    Returns
    -------
    ndarray of int32, in the shape of the map's grid
        0 where there is no cluster; the clusters have the numbers from 1 on.
    """
    mask = belief.planning.frontier_mask(belief, robot)
    labels, _ = label(mask, np.ones((3,) * mask.ndim, dtype=int))
    kept = np.bincount(labels.ravel()) >= min_cells
    kept[0] = False
    numbers = np.cumsum(kept, dtype=np.int32) * kept
    clusters: NDArray[np.int32] = numbers[labels]
    return clusters


def clusters_of_poses(
    belief: Belief, robot: int, poses: Poses, min_cells: int
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """The labels of all clusters, and the cluster of each pose (k,), 0 for none."""
    labels = cluster_labels(belief, robot, min_cells)
    return labels, belief.planning.frontier_of_poses(belief, robot, poses, labels)
