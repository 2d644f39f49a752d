"""One frame for the team, where the target alone does not tell which: symmetric targets.

A target that maps onto itself has several frames that fit it alike. Any of them will do for the
first robot that is located; the others have to take the same one, and only the scene besides the
target tells which that is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Pose
from coopmap_env.localization.registration.register import Registration
from coopmap_env.localization.registration.views import View
from coopmap_env.localization.target import TargetModel
from coopmap_env.mapping import OccupancyMap

MIN_VOXELS = 30
"""Voxels besides the target, of which both robot and map know: with fewer nothing is decided."""
MIN_MARGIN = 0.5
"""Nats a voxel by which the best frame must be likelier than the next."""
TARGET_PADDING = 0.2
"""Metres around the target that belong to it: it looks alike in all frames."""
GROUND_HEIGHT = 0.1
"""Metres above the ground up to which points tell nothing: it looks alike too."""
MAX_LOG_ODDS = 3.0
"""Nats at most that one voxel says for a frame, or against it."""


def in_equivalent_frame(found: Registration, T_target_base: Pose) -> Registration:
    """The same registration in another of its equivalent frames."""
    if found.T_target_base is None or found.covariance is None:
        raise ValueError(f"nothing is located: {found.reason}")
    turn = T_target_base.rotation @ found.T_target_base.rotation.T
    both = np.kron(np.eye(2), turn)
    return replace(found, T_target_base=T_target_base, covariance=both @ found.covariance @ both.T)


def resolve_symmetry(
    map_: OccupancyMap, found: Registration, views: Sequence[View], model: TargetModel
) -> Registration:
    """The registration in that of its equivalent frames in which the views fit the team's map.

    The occupancy of each voxel in which the views have points, the target's and the ground's left
    out, is summed in nats. Not located, with the reason, if no frame is clearly the likeliest.

    Parameters
    ----------
    map_ : OccupancyMap
        The team's, in the target's frame.
    found : Registration
        Located, with two equivalents or more.
    views : sequence of View
        In the base frame.
    model : TargetModel
    """
    points = np.concatenate(
        [view.estimate.pose.transform(view.cloud.points[view.cloud.hit]) for view in views]
    )
    support = [mean_log_odds(map_, T.transform(points), model) for T in found.equivalent_poses]
    known = min(count for _, count in support)
    order = np.argsort([-value for value, _ in support], kind="stable")
    margin = support[order[0]][0] - support[order[1]][0]
    if known < MIN_VOXELS or margin < MIN_MARGIN:
        return replace(
            found,
            located=False,
            T_target_base=None,
            covariance=None,
            reason=f"the target looks alike from {len(found.equivalent_poses)} sides, and what else is "
            f"seen does not tell them apart ({known} voxels, {margin:.2f} nats)",
        )
    return in_equivalent_frame(found, found.equivalent_poses[order[0]])


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
    odds = map_.log_odds.ravel()[cells] if len(cells) else np.zeros(0)
    return (float(np.clip(odds, -MAX_LOG_ODDS, MAX_LOG_ODDS).mean()) if len(cells) else 0.0), len(
        cells
    )
