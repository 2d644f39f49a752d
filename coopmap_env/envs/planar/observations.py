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

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.elementary import log
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import length
from coopmap_env.envs.belief import Observation
from coopmap_env.envs.planar._observation_kernels import (
    CropTables,
    FeatureScale,
    ObservationArrays,
    WorldExtent,
    crop_offsets,
    write_candidate_features,
    write_observations,
)
from coopmap_env.envs.planar.belief import PlanarBelief

N_CHANNELS = 4
N_FEATURES = 9
FEATURE_LIMIT = 10.0
BYTES_PER_CROP_CELL = 40
"""Memory that it takes to prepare a cell of the crop for one heading."""


class PlanarObserver:
    """Computes observations and declares their spaces; one object per environment."""

    def __init__(self, belief: PlanarBelief, crop_cells: int, n_candidates: int | None) -> None:
        grid = belief.map.grid
        self._n_robots = len(belief.agents)
        self._crop_cells = crop_cells
        self._n_candidates = n_candidates
        self._shape = grid.shape
        size = tuple(n * grid.resolution for n in grid.shape)
        self._world = tuple(WorldExtent(grid.origin, size, grid.resolution))
        check_bytes(
            BYTES_PER_CROP_CELL * belief.lattice.n_headings * crop_cells**2,
            "the observed crop for all headings (crop_cells, n_headings)",
        )
        features = 4 * N_FEATURES * (n_candidates or 0)
        check_bytes(
            self._n_robots * (N_CHANNELS * crop_cells**2 + features),
            "an observation of all robots (n_robots, crop_cells, n_candidates)",
        )
        offsets = crop_offsets(crop_cells, belief.lattice.n_headings)
        byte_of_log_odds = np.round(255 * belief.map.log_odds_range.probability).astype(np.uint8)
        self._tables = tuple(CropTables(offsets, int(np.abs(offsets).max()), byte_of_log_odds))
        max_information = log(belief.rating_function.settings.n_gray_bins)
        self._scale = tuple(
            FeatureScale(
                length(size),
                max_information,
                belief.rating_function.max_visible_cells,
                FEATURE_LIMIT,
            )
        )

    def space(self, robot: int) -> spaces.Dict:
        """Make a new observation space of one robot."""
        v, m = self._crop_cells, self._n_candidates
        parts: dict[str, spaces.Space[Any]] = {
            "map": spaces.Box(0, 255, (N_CHANNELS, v, v), np.uint8),
            "pose": spaces.Box(-1.0, 1.0, (4,), np.float32),
        }
        if self._n_robots > 1:
            parts["teammates"] = spaces.Box(-1.0, 1.0, (self._n_robots - 1, 4), np.float32)
        if m is not None:
            parts["candidates"] = spaces.Box(
                -FEATURE_LIMIT, FEATURE_LIMIT, (m, N_FEATURES), np.float32
            )
            parts["action_mask"] = spaces.Box(0, 1, (m,), np.int8)
        return spaces.Dict(parts)

    def observe(self, belief: PlanarBelief) -> list[Observation]:
        """Observations of all robots, as new arrays."""
        drawn = self._draw(belief)
        observations: list[Observation] = [
            {"map": image, "pose": pose}
            for image, pose in zip(drawn.maps, drawn.pose_vectors, strict=True)
        ]
        if self._n_robots > 1:
            for observation, teammates in zip(observations, drawn.teammates, strict=True):
                observation["teammates"] = teammates
        if belief.candidates is not None and self._n_candidates is not None:
            described = self._candidate_features(belief, belief.candidates, self._n_candidates)
            for observation, features, mask in zip(observations, *described, strict=True):
                observation["candidates"], observation["action_mask"] = features, mask
        return observations

    def state_space(self) -> spaces.Box:
        """Box (2 nx ny + 4 n_robots,) float32 in [-1, 1]; see `state`."""
        size = 2 * math.prod(self._shape) + 4 * self._n_robots
        return spaces.Box(-1.0, 1.0, (size,), np.float32)

    def state(self, belief: PlanarBelief) -> NDArray[np.float32]:
        """The team map and all poses as one vector, for centralised critics.

        First P(occupied), then sampled (each nx ny values, row-major), then four values a robot
        as in the observation's ``pose``.
        """
        map_, poses = belief.map, self._draw(belief).pose_vectors
        parts: list[NDArray[Any]] = [map_.probability.ravel(), map_.sampled_mask, poses.ravel()]
        return np.concatenate(parts, dtype=np.float32, casting="same_kind")

    def _draw(self, belief: PlanarBelief) -> ObservationArrays:
        """The entries ``map``, ``pose`` and ``teammates`` of all robots."""
        n, side = self._n_robots, self._crop_cells
        out = ObservationArrays(
            np.empty((n, N_CHANNELS, side, side), dtype=np.uint8),
            np.empty((n, 4), dtype=np.float32),
            np.empty((n, n - 1, 4), dtype=np.float32),
        )
        pose_ids = np.array(belief.pose_ids)
        write_observations(
            tuple(belief.map.arrays), self._world, self._tables, pose_ids, belief.camera_poses, *out
        )
        return out

    def _candidate_features(
        self, belief: PlanarBelief, candidates: Sequence[NDArray[np.int64]], m: int
    ) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """The entries ``candidates`` and ``action_mask`` of all robots."""
        rating, ids = belief.rating_function, np.concatenate(candidates)
        counts = np.array([len(robot_candidates) for robot_candidates in candidates])
        ni, unknown = rating.new_information_and_unknown(belief.map, ids)
        distance = rating.distance(ids, np.repeat(belief.pose_ids, counts))
        rated = rating.rate_from_new_information(belief.map, ids, distance, ni)
        features = np.zeros((self._n_robots, m, N_FEATURES), dtype=np.float32)
        mask = np.zeros((self._n_robots, m), dtype=np.int8)
        write_candidate_features(
            ids, counts, belief.camera_poses, tuple(belief.lattice.geometry),
            (ni, rated.motion_cost, rated.occupancy, rated.rating, unknown),
            self._scale, features, mask,
        )  # fmt: skip
        return features, mask
