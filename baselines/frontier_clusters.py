"""Clusters of frontier cells, and what the poses at them are worth."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs import Belief, Poses
from coopmap_env.information import ReservedMask

DETOUR = 0.1
"""Part of the distance to a far target by which a pose may be farther from it than the nearest."""


def frontier_clusters(belief: Belief, robot: int, min_cells: int) -> NDArray[np.int32]:
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
    from scipy.ndimage import label  # a third of a second, seldom needed

    mask = belief.planning.frontier_mask(belief, robot)
    labels, _ = label(mask, np.ones((3,) * mask.ndim, dtype=int))
    kept = np.bincount(labels.ravel()) >= min_cells
    kept[0] = False
    numbers = np.cumsum(kept, dtype=np.int32) * kept
    clusters: NDArray[np.int32] = numbers[labels]
    return clusters


def frontier_poses(
    belief: Belief, robot: int, clusters: NDArray[np.int32]
) -> tuple[Poses, NDArray[np.int32]]:
    """Poses that a robot may go to, in one action or in several, and the cluster of each.

    Those at clusters. In "candidates" mode, the candidates and what is too far for one action.
    Where there are none, all feasible poses. The number of the cluster is 0 for none.
    """
    planning, candidates = belief.planning, belief.candidates
    poses, numbers = planning.frontier_poses(belief, robot, clusters)
    if candidates is not None:
        far = planning.n_actions(belief, robot, poses) > 1
        own = candidates[robot]
        at = planning.clusters_of_poses(belief, robot, own, clusters)
        return np.concatenate([own, poses[far]]), np.concatenate([at, numbers[far]])
    if not len(poses):
        poses = belief.feasible_poses(robot)
        numbers = np.zeros(len(poses), dtype=np.int32)
    return poses, numbers


def utility_of_poses(
    belief: Belief,
    robot: int,
    poses: Poses,
    motion_weight: float,
    reserved_mask: ReservedMask | None,
) -> NDArray[np.float64]:
    """What going to each pose is worth, (k,): its gain minus motion, for each action.

    Parameters
    ----------
    belief : Belief
    robot : int
    poses : Poses
        Also such that no single action reaches.
    motion_weight : float
        Gain, as a fraction of a full view, that is worth one unit of d (Eq. 5).
    reserved_mask : ndarray or None
        Cells that do not count.
    """
    planning = belief.planning
    gain = planning.expected_unknown_fraction(belief, robot, poses, reserved_mask)
    worth = gain - motion_weight * belief.distance(robot, poses)
    return worth / planning.n_actions(belief, robot, poses)


def pose_towards(
    belief: Belief, robot: int, target: Any, reserved_mask: ReservedMask | None
) -> Any:
    """The target, or if it is too far for one action, a pose nearer to it.

    Of the poses that are hardly farther from the target than the nearest one, that which is
    expected to show most.
    """
    candidates = belief.candidates
    poses = belief.feasible_poses(robot) if candidates is None else candidates[robot]
    if (poses == target).reshape(len(poses), -1).all(axis=1).any():
        return target
    left = belief.planning.foresight(belief).distance(robot, poses, target)
    nearest_first = np.argsort(left, kind="stable")
    slack = DETOUR * belief.distance(robot, np.array([target]))[0]
    near = nearest_first[left[nearest_first] <= left.min() + slack]
    gain = belief.planning.expected_unknown_fraction(belief, robot, poses[near], reserved_mask)
    return poses[near[np.argmax(gain)]]
