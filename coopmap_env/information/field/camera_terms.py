"""The terms of Eq. 9 besides new information: P at the camera and the motion cost."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.information.ratings import write_ratings


@kernel
def write_occupancy(
    map_tuple: PlainTuple,
    points: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write P (k,) of the cells that hold points (k, 3), metres; 1 outside the grid.

    `map_tuple` holds log-odds in fixed point, their clamp, the table of their P, and the plain
    `GridGeometry`.
    """
    log_odds_fixed, clamp, probability, (lower, resolution, shape) = map_tuple
    for k in range(len(points)):
        cell, inside = 0, True
        for axis in range(3):
            index = np.floor((points[k, axis] - lower[axis]) / resolution)
            inside &= 0.0 <= index < shape[axis]
            cell = cell * shape[axis] + int(index if inside else 0.0)
        out[k] = probability[log_odds_fixed[cell] + clamp] if inside else 1.0


@kernel
def rate_cameras(
    map_tuple: PlainTuple,
    points: NDArray[np.float64],
    cost_law: tuple[float, float],
    ni: NDArray[np.float64],
    d: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Eq. 9: write K d**n, P and RF of cameras at points (k, 3), one row each, to `out` (3, k).

    `cost_law` is K and n; see `write_occupancy`.
    """
    write_occupancy(map_tuple, points, out[1])
    write_ratings(cost_law, ni, d, out)
