"""The team's frame with a symmetric target, which fits several frames alike.

The first located robot may take any of them. The others have to take the same one, and only the
scene around the target distinguishes them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose
from coopmap_env.localization.failures import LocalizationFailure
from coopmap_env.localization.registration.register import Registration
from coopmap_env.localization.registration.views import View
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import OccupancyMap

MIN_VOXELS = 30
"""Voxels, besides the target, that both the robot has measured and the map knows."""
MIN_MARGIN = 0.5
"""Nats per voxel by which the best frame must exceed the next."""
TARGET_PADDING = 0.2
"""Metres around the target that belong to it: it is the same in all frames."""
GROUND_HEIGHT = 0.1
"""Metres above the ground below which points are left out: it is the same in all frames too."""
MAX_LOG_ODDS = 3.0
"""Nats to which a voxel's log-odds are clipped, so that a few do not decide."""


def in_equivalent_frame(registration: Registration, T_target_base: Pose) -> Registration:
    """The same registration in another of its equivalent frames.

    Raises
    ------
    ValueError
        If the robot is not located.
    """
    if registration.T_target_base is None or registration.covariance is None:
        raise ValueError(f"robot is not located: {registration.reason}")
    rotation = product(T_target_base.rotation, registration.T_target_base.rotation.T)
    both = np.kron(np.eye(2), rotation)
    covariance = product(product(both, registration.covariance), both.T)
    return replace(registration, T_target_base=T_target_base, covariance=covariance)


def resolve_symmetry(
    map_: OccupancyMap, registration: Registration, views: Sequence[View], model: TargetModel
) -> Registration:
    """The registration in the equivalent frame in which the views fit the team's map best.

    A frame's score is the mean log-odds of the voxels in which the views have points; those of the
    target and the ground are left out. If no frame is clearly the likeliest, the robot is not
    located, with the reason.

    Parameters
    ----------
    map_ : OccupancyMap
        The team's map, in the target's frame.
    registration : Registration
        Located, with at least two equivalent poses.
    views : sequence of View
        In the base frame.
    model : TargetModel
    """
    points = np.concatenate(
        [view.estimate.pose.transform(view.cloud.points[view.cloud.hit]) for view in views]
    )
    poses = registration.equivalent_poses
    support = [mean_log_odds(map_, T.transform(points), model) for T in poses]
    n_voxels = min(count for _, count in support)
    order = np.argsort([-value for value, _ in support], kind="stable")
    margin = support[order[0]][0] - support[order[1]][0]
    if n_voxels < MIN_VOXELS or margin < MIN_MARGIN:
        reason = (
            f"target has {len(poses)} equivalent poses, and the scene around it does not "
            f"distinguish them ({n_voxels} voxels, {margin:.2f} nats)"
        )
        return replace(
            registration,
            failure=LocalizationFailure.SYMMETRIC,
            reason=reason,
            T_target_base=None,
            covariance=None,
        )
    return in_equivalent_frame(registration, poses[order[0]])


def mean_log_odds(
    map_: OccupancyMap, points: NDArray[np.float64], model: TargetModel
) -> tuple[float, int]:
    """Mean log-odds, nats, of the known voxels that hold points (n, 3), and how many there are."""
    low, high = model.bounds[0] - TARGET_PADDING, model.bounds[1] + TARGET_PADDING
    outside = ~((points > low) & (points < high)).all(axis=1) & (points[:, 2] > GROUND_HEIGHT)
    index = map_.grid.index(points[outside])
    index = index[map_.grid.contains(index)]
    cells = np.unique(map_.grid.flat_index(index)) if len(index) else np.empty(0, dtype=np.int64)
    cells = cells[map_.sampled_mask[cells].view(np.bool_)]
    if not len(cells):
        return 0.0, 0
    log_odds = np.clip(map_.log_odds.ravel()[cells], -MAX_LOG_ODDS, MAX_LOG_ODDS)
    return float(log_odds.mean()), len(cells)
