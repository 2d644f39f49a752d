"""What each robot observes, and what a centralised critic may see.

Observation of one robot, a `Dict`:

``map``: uint8 (4, V, V), V = `PlanarSettings.view_cells`. The local probabilistic map in the
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
0, 1     x, y as shares of the world's sides, 0 to 1
2, 3     cosine and sine of the heading
=======  ==========================================

``teammates``: float32 (n_robots - 1, 4) in [-1, 1], in order of their numbers; absent for a single
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
4        NI (Eqs. 6-8) as a share of its maximum, ln(n_gray)
5        motion cost K d**n (Eqs. 5, 9) as a share of ln(n_gray), at most 10
6        P at the camera position
7        rating (Eq. 9) as a share of ln(n_gray), at least -10
8        never-sampled cells in view, as a share of the most the camera sees
=======  ===================================================================
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from gymnasium import spaces
from numba import njit
from numpy.typing import NDArray

from coopmap_env.envs.belief import Belief
from coopmap_env.geometry import to_camera_frame

N_CHANNELS = 4
N_FEATURES = 9
FEATURE_LIMIT = 10.0
Observation = dict[str, NDArray[Any]]


def view_offsets(side: int, n_headings: int) -> NDArray[np.int32]:
    """Cell offsets (n_headings, side * side, 2) of the local map's cells from the camera's cell."""
    steps = np.arange(side) + 0.5 - side / 2
    ahead, left = np.meshgrid(steps, steps, indexing="ij")
    angles = np.arange(n_headings)[:, None] * (2 * math.pi / n_headings)
    c, s = np.cos(angles), np.sin(angles)
    x = c * ahead.ravel() - s * left.ravel()
    y = s * ahead.ravel() + c * left.ravel()
    # 1e-9: a point on the border between two cells goes to the same side for every heading
    return np.floor(np.stack([x, y], axis=-1) + 0.5 + 1e-9).astype(np.int32)


@njit(cache=True, nogil=True)
def draw_local_map(levels, sampled, nx, ny, cell, offsets, shades, clamp, out):
    """Fill channels 0, 1 and 3 and clear 2; `out` is (4, side * side)."""
    cx, cy = cell // ny, cell % ny
    margin = max(-offsets.min(), offsets.max())
    out[2] = 0
    if margin <= cx < nx - margin and margin <= cy < ny - margin:  # the world is all around
        out[3] = 255
        for k in range(out.shape[1]):
            at = cell + offsets[k, 0] * ny + offsets[k, 1]
            out[0, k] = shades[levels[at] + clamp]
            out[1, k] = np.uint8(255) * sampled[at]
        return
    for k in range(out.shape[1]):
        ix, iy = cx + offsets[k, 0], cy + offsets[k, 1]
        inside = 0 <= ix < nx and 0 <= iy < ny
        at = ix * ny + iy if inside else 0
        out[0, k] = shades[levels[at] + clamp] if inside else shades[clamp]
        out[1, k] = np.uint8(255) * sampled[at] if inside else 0
        out[3, k] = 255 if inside else 0


@njit(cache=True, nogil=True)
def draw_teammates(poses, robot, resolution, diagonal, out, teammates):
    """Fill channel 2 and the rows of `teammates`."""
    side = out.shape[1]
    middle = side / 2.0 + 1e-9  # a mate on the border of two cells: as in `view_offsets`
    c, s = math.cos(poses[robot, 2]), math.sin(poses[robot, 2])
    row = 0
    for mate in range(len(poses)):
        if mate == robot:
            continue
        dx, dy = poses[mate, 0] - poses[robot, 0], poses[mate, 1] - poses[robot, 1]
        ahead, left, turn = c * dx + s * dy, c * dy - s * dx, poses[mate, 2] - poses[robot, 2]
        teammates[row, 0] = ahead / diagonal
        teammates[row, 1] = left / diagonal
        teammates[row, 2] = math.cos(turn)
        teammates[row, 3] = math.sin(turn)
        row += 1
        i = math.floor(ahead / resolution + middle)
        j = math.floor(left / resolution + middle)
        for u in range(max(i - 1, 0), min(i + 2, side)):
            for v in range(max(j - 1, 0), min(j + 2, side)):
                out[2, u, v] = 255


class Observer:
    """Fills observations; one object per environment, its spaces declared beside."""

    def __init__(self, belief: Belief, view_cells: int, n_candidates: int | None) -> None:
        grid = belief.map.grid
        self._n_robots = len(belief.agents)
        self._view_cells = view_cells
        self._n_candidates = n_candidates
        self._shape = grid.shape
        self._origin = grid.origin
        self._size = tuple(n * grid.resolution for n in grid.shape)
        self._diagonal = math.hypot(*self._size)
        self._shades = np.round(255 * belief.map.range.probability).astype(np.uint8)
        self._offsets = view_offsets(view_cells, belief.lattice.n_headings)
        self._scale = math.log(belief.rating.settings.n_gray)

    def space(self) -> spaces.Dict:
        """Make a new observation space of one robot."""
        v, m = self._view_cells, self._n_candidates
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

    def observe(self, belief: Belief, robot: int) -> Observation:
        """Fill the observation of one robot, as new arrays."""
        map_, poses, side = belief.map, belief.poses, self._view_cells
        image = np.empty((N_CHANNELS, side, side), dtype=np.uint8)
        teammates = np.empty((self._n_robots - 1, 4), dtype=np.float32)
        pose = self._pose(poses[robot])
        nx, ny = self._shape
        cell, heading = divmod(belief.pose_ids[robot], belief.lattice.n_headings)
        draw_local_map(
            map_.levels, map_.sampled_cells, nx, ny, cell, self._offsets[heading],
            self._shades, map_.range.clamp, image.reshape(N_CHANNELS, -1),
        )  # fmt: skip
        draw_teammates(poses, robot, map_.grid.resolution, self._diagonal, image, teammates)
        observation: Observation = {"map": image, "pose": np.array(pose, dtype=np.float32)}
        if self._n_robots > 1:
            observation["teammates"] = teammates
        if belief.offers is not None and self._n_candidates is not None:
            offers = belief.offers[robot]
            features = np.zeros((self._n_candidates, N_FEATURES), dtype=np.float32)
            features[: len(offers)] = self._features(belief, robot, offers)
            observation["candidates"] = features
            observation["action_mask"] = (np.arange(self._n_candidates) < len(offers)).astype(
                np.int8
            )
        return observation

    def state_space(self) -> spaces.Box:
        """Box (2 nx ny + 4 n_robots,) float32 in [-1, 1]; see `state`."""
        size = 2 * math.prod(self._shape) + 4 * self._n_robots
        return spaces.Box(-1.0, 1.0, (size,), np.float32)

    def state(self, belief: Belief) -> NDArray[np.float32]:
        """Write the team map and all poses in one vector, for centralised critics.

        First P(occupied), then sampled (each nx ny values, row-major), then four values a robot
        as in the observation's ``pose``.
        """
        map_ = belief.map
        poses = np.ravel([self._pose(pose) for pose in belief.poses])
        parts: list[NDArray[Any]] = [map_.probability.ravel(), map_.sampled_cells, poses]
        return np.concatenate(parts, dtype=np.float32, casting="same_kind")

    def _pose(self, pose: NDArray[np.float64]) -> tuple[float, float, float, float]:
        """Return the observation's ``pose``."""
        x, y, heading = pose.tolist()
        (x0, y0), (width, height) = self._origin, self._size
        return (x - x0) / width, (y - y0) / height, math.cos(heading), math.sin(heading)

    def _features(
        self, belief: Belief, robot: int, offers: NDArray[np.int64]
    ) -> NDArray[np.float32]:
        rating = belief.rating
        rated = rating.rate(belief.map, offers, belief.pose_ids[robot])
        out = np.empty((len(offers), N_FEATURES), dtype=np.float32)
        relative = to_camera_frame(belief.lattice.poses(offers), belief.poses[robot])
        out[:, :2] = relative[:, :2] / self._diagonal
        out[:, 2] = np.cos(relative[:, 2])
        out[:, 3] = np.sin(relative[:, 2])
        out[:, 4] = rated.new_information / self._scale
        cost = rating.settings.K * rated.distance**rating.settings.exponent
        out[:, 5] = np.minimum(cost / self._scale, FEATURE_LIMIT)
        out[:, 6] = rated.occupancy
        out[:, 7] = np.maximum(rated.rating / self._scale, -FEATURE_LIMIT)
        out[:, 8] = rating.unknown_cells(belief.map, offers) / rating.fan.n_visible
        return out
