"""Kernels that write what robots observe: local map, own pose, teammates, candidates."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import TWO_PI
from coopmap_env.robots import pose_from_id


def crop_offsets(side: int, n_headings: int) -> NDArray[np.int32]:
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
def write_map_crop(log_odds_fixed, sampled, nx, ny, cell, offsets, margin, gray_values, clamp, out):
    """Fill channels 0, 1 and 3 and clear 2; `out` is (4, side * side).

    `margin` is the largest offset along an axis: further than this from the border of the world no
    cell needs to be asked whether it lies inside.
    """
    cx, cy = cell // ny, cell % ny
    out[2] = 0
    if margin <= cx < nx - margin and margin <= cy < ny - margin:  # the world is all around
        out[3] = 255
        for k in range(out.shape[1]):
            # the compiler guards signed indices against negative ones
            at = np.uint64(cell + offsets[k, 0] * ny + offsets[k, 1])
            out[0, k] = gray_values[np.uint64(log_odds_fixed[at] + clamp)]
            out[1, k] = np.uint8(255) * sampled[at]
        return
    for k in range(out.shape[1]):
        ix, iy = cx + offsets[k, 0], cy + offsets[k, 1]
        inside = 0 <= ix < nx and 0 <= iy < ny
        at = np.uint64(ix * ny + iy if inside else 0)
        out[0, k] = gray_values[np.uint64(log_odds_fixed[at] + clamp if inside else clamp)]
        out[1, k] = np.uint8(255) * sampled[at] if inside else 0
        out[3, k] = 255 if inside else 0


@njit(cache=True, nogil=True)
def write_teammates(poses, robot, resolution, diagonal, out, teammates):
    """Fill channel 2 and the rows of `teammates`."""
    side = out.shape[1]
    middle = side / 2.0 + 1e-9  # a mate on the border of two cells: as in `crop_offsets`
    c, s = math.cos(poses[robot, 2]), math.sin(poses[robot, 2])
    row = 0
    for teammate in range(len(poses)):
        if teammate == robot:
            continue
        dx, dy = poses[teammate, 0] - poses[robot, 0], poses[teammate, 1] - poses[robot, 1]
        ahead, left, turn = c * dx + s * dy, c * dy - s * dx, poses[teammate, 2] - poses[robot, 2]
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


@njit(cache=True, nogil=True)
def write_observations(
    log_odds_fixed, sampled, nx, ny, ids, poses, origin, size, resolution,
    offsets, margin, gray_values, clamp, images, vectors, teammates,
):  # fmt: skip
    """Fill the images, own poses and teammates of all robots.

    `ids` are lattice numbers, `poses` (n, 3) the same in metres and radians.
    """
    n_headings = len(offsets)
    diagonal = math.hypot(size[0], size[1])
    for robot in range(len(ids)):
        cell, heading = ids[robot] // n_headings, ids[robot] % n_headings
        image = images[robot]
        flat = image.reshape(image.shape[0], -1)
        write_map_crop(
            log_odds_fixed,
            sampled,
            nx,
            ny,
            cell,
            offsets[heading],
            margin,
            gray_values,
            clamp,
            flat,
        )
        write_teammates(poses, robot, resolution, diagonal, image, teammates[robot])
        vectors[robot, 0] = (poses[robot, 0] - origin[0]) / size[0]
        vectors[robot, 1] = (poses[robot, 1] - origin[1]) / size[1]
        vectors[robot, 2] = math.cos(poses[robot, 2])
        vectors[robot, 3] = math.sin(poses[robot, 2])


@njit(cache=True, nogil=True)
def _wrapped(angle):
    """One angle in [-pi, pi), bit for bit as of `wrap_angle`."""
    turned = (angle + math.pi) % TWO_PI
    return (turned if turned < TWO_PI else 0.0) - math.pi


@njit(cache=True, nogil=True)
def write_candidate_features(ids, counts, cameras, layout, rated, units, features, mask):
    """Fill the features and masks of all robots' candidates.

    `ids` (k,) are the lattice numbers of the first robot's candidates, then those of the next;
    `counts` says how many each robot has, `cameras` (n, 3) where it is. `rated` is (NI, motion
    cost, P, rating, unknown cells), each (k,); `units` (diagonal, most information, most cells in
    view, limit) is what features are measured in and how large they can be.
    """
    new_information, cost, occupancy, rating, unknown = rated
    diagonal, max_information, largest_fan_size, limit = units
    k = 0
    for robot in range(len(counts)):
        x, y, heading = cameras[robot]
        c, s = math.cos(heading), math.sin(heading)
        for row in range(counts[robot]):
            at_x, at_y, at_heading = pose_from_id(ids[k], layout)
            dx, dy, turn = at_x - x, at_y - y, _wrapped(at_heading - heading)
            out = features[robot, row]
            out[0] = (c * dx + s * dy) / diagonal
            out[1] = (c * dy - s * dx) / diagonal
            out[2] = math.cos(turn)
            out[3] = math.sin(turn)
            out[4] = new_information[k] / max_information
            out[5] = min(cost[k] / max_information, limit)
            out[6] = occupancy[k]
            out[7] = max(rating[k] / max_information, -limit)
            out[8] = unknown[k] / largest_fan_size
            mask[robot, row] = 1
            k += 1
