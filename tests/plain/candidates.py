"""Candidates of a planar robot and their features, one pose at a time."""

import math

import numpy as np

from coopmap_env.geometry import to_camera_frame


def candidate_features(belief, robot, pose_id):
    """The nine features of one candidate; see `coopmap_env.envs.planar.observations`."""
    lattice, rating, grid = belief.lattice, belief.rating_function, belief.map.grid
    here = belief.pose_ids[robot]
    ahead, left, turn = to_camera_frame(lattice.pose(pose_id), lattice.pose(here)).tolist()
    rated = rating.rate(belief.map, [pose_id], rating.distance([pose_id], here))
    diagonal = math.hypot(*(n * grid.resolution for n in grid.shape))
    max_entropy = math.log(rating.settings.n_gray_bins)
    visible = rating.visible_cells(belief.map, pose_id)
    unknown = int(np.count_nonzero(belief.map.sampled_mask[visible] == 0))
    values = [
        ahead / diagonal,
        left / diagonal,
        math.cos(turn),
        math.sin(turn),
        rated.new_information[0] / max_entropy,
        min(rated.motion_cost[0] / max_entropy, 10.0),
        rated.occupancy[0],
        max(rated.rating[0] / max_entropy, -10.0),
        unknown / rating.fan.max_visible_cells,
    ]
    return np.array(values).astype(np.float32)
