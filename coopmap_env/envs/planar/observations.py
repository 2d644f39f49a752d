"""Observations of a planar robot, and of a centralised critic.

Observation of one robot, a `Dict`:

``map``: uint8 (4, V, V), V = `PlanarSettings.crop_cells`. A crop of the probabilistic map in the
camera's frame: cell [i, j] lies i + 1/2 - V/2 cells ahead of the camera and j + 1/2 - V/2 cells to
its left (nearest cell of the map).

=======  ====================  ===================================================
channel  content               values
=======  ====================  ===================================================
0        occupancy             255 P(occupied), rounded; 128 where nothing is known
1        sampled               255 if the cell was ever sampled
2        teammates             255 at the 3 x 3 cells around a teammate's camera
3        inside the world      255 inside
=======  ====================  ===================================================

``pose``: float32 (4,) in [-1, 1].

=======  ==========================================
index    content
=======  ==========================================
0, 1     x, y as fractions of the world's sides
2, 3     cosine and sine of the heading
=======  ==========================================

``teammates``: float32 (n_robots - 1, 4) in [-1, 1], in order of their indices; absent for a single
robot.

=======  ================================================================
index    content
=======  ================================================================
0, 1     ahead, left in the own camera frame, in diagonals of the world
2, 3     cosine and sine of the teammate's heading relative to the own
=======  ================================================================

``budget``: float32 (2,) in [0, 1], what is left of the episode.

=======  =====================================================================
index    content
=======  =====================================================================
0        scans of each robot, as a fraction of ``max_scans``
1        time, as a fraction of ``max_time``; 1 where time does not end it
=======  =====================================================================

In "candidates" mode also ``candidates``: float32 (m, 9), zeros where masked, and ``action_mask``:
int8 (m,), 1 where the candidate can be taken.

=======  ===================================================================
index    content
=======  ===================================================================
0, 1     ahead, left of the camera now, in diagonals of the world
2, 3     cosine and sine of the turn
4        NI (Eqs. 6-8) as a fraction of its maximum, ln(n_gray_bins)
5        motion cost (Eqs. 5, 9) as a fraction of ln(n_gray_bins), at most 10
6        P(occupied) at the camera position
7        rating (Eq. 9) as a fraction of ln(n_gray_bins), at least -10
8        never-sampled cells in view, as a fraction of the most it can see
=======  ===================================================================
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import length
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.planar._observation_kernels import (
    N_CHANNELS,
    N_FEATURES,
    CropTables,
    FeatureScale,
    ObservationArrays,
    TeamObservations,
    WorldExtent,
    write_pose_vector,
)
from coopmap_env.envs.planar.belief import PlanarBelief
from coopmap_env.envs.planar.task import PlanarTask
from coopmap_env.information import PlanarRatingFunction

__all__ = ["ObservationArrays", "PlanarObserver", "TeamObservations", "observation_tables"]

FEATURE_LIMIT = 10.0
BYTES_PER_CROP_CELL = 40
"""Memory that it takes to prepare a cell of the crop for one heading."""


class ObservationTables(NamedTuple):
    """What the kernels of observations need."""

    crop: CropTables
    extent: WorldExtent
    feature_scale: FeatureScale


def observation_tables(task: PlanarTask, rating: PlanarRatingFunction) -> ObservationTables:
    """Tables for the observations of a task."""
    s, grid = task.settings, task.grid
    extent = WorldExtent.of_grid(grid)
    return ObservationTables(
        CropTables.make(s.crop_cells, s.n_headings, grid.shape[1], s.log_odds_range),
        extent,
        FeatureScale(
            length(extent.size),
            log(s.rating.n_gray_bins),
            rating.max_visible_cells,
            FEATURE_LIMIT,
        ),
    )


class PlanarObserver:
    """Declares the spaces of observations, and makes them of the arrays of a step.

    The entry ``budget`` and the end of the state are the same in all environments: `MappingEnv`
    adds them.

    Raises
    ------
    ValueError
        If observations, or the tables for them, take more memory than `coopmap_env.core.limits`
        allows.
    """

    def __init__(self, task: PlanarTask) -> None:
        s = task.settings
        check_bytes(
            BYTES_PER_CROP_CELL * s.n_headings * s.crop_cells**2,
            "the observed crop for all headings (crop_cells, n_headings)",
        )
        check_bytes(
            task.n_robots * (N_CHANNELS * s.crop_cells**2 + 4 * N_FEATURES * task.n_candidates),
            "an observation of all robots (n_robots, crop_cells, n_candidates)",
        )
        self._task = task
        self._extent = tuple(WorldExtent.of_grid(task.grid))

    def space(self, robot: int) -> spaces.Dict:
        """Make a new observation space of one robot."""
        v, m = self._task.settings.crop_cells, self._task.n_candidates
        parts: dict[str, spaces.Space[Any]] = {
            "map": spaces.Box(0, 255, (N_CHANNELS, v, v), np.uint8),
            "pose": spaces.Box(-1.0, 1.0, (4,), np.float32),
        }
        if self._task.n_robots > 1:
            parts["teammates"] = spaces.Box(-1.0, 1.0, (self._task.n_robots - 1, 4), np.float32)
        if m:
            parts["candidates"] = spaces.Box(
                -FEATURE_LIMIT, FEATURE_LIMIT, (m, N_FEATURES), np.float32
            )
            parts["action_mask"] = spaces.Box(0, 1, (m,), np.int8)
        return spaces.Dict(parts)

    def name_parts(self, arrays: TeamObservations) -> Observation:
        """The entries of observations, each with its leading axes of worlds and robots."""
        views = arrays.views
        parts: Observation = {"map": views.maps, "pose": views.pose_vectors}
        if self._task.n_robots > 1:
            parts["teammates"] = views.teammates
        if self._task.n_candidates:
            parts["candidates"], parts["action_mask"] = arrays.features, arrays.action_mask
        return parts

    def state_space(self) -> spaces.Box:
        """Box (2 nx ny + 4 n_robots,) float32 in [-1, 1]; see `state`.

        That of the environment has the two values of ``budget`` behind them.
        """
        size = 2 * self._task.grid.n_cells + 4 * self._task.n_robots
        return spaces.Box(-1.0, 1.0, (size,), np.float32)

    def state(self, belief: PlanarBelief) -> NDArray[np.float32]:
        """The team map and all poses as one vector, for centralised critics.

        First P(occupied), then sampled (each nx ny values, row-major), then four values a robot
        as in the observation's ``pose``.
        """
        map_, poses = belief.map, belief.camera_poses
        vectors = np.empty((len(poses), 4), dtype=np.float32)
        for pose, vector in zip(poses, vectors, strict=True):
            write_pose_vector(pose, self._extent, vector)
        parts: list[NDArray[Any]] = [map_.probability.ravel(), map_.sampled_mask, vectors.ravel()]
        return np.concatenate(parts, dtype=np.float32, casting="same_kind")
