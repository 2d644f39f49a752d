"""How long a planar camera takes from one pose of the lattice to another."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, kernel


class LatticeSpeeds(NamedTuple):
    """How fast a planar camera moves over its lattice."""

    cells: float
    """Cells a second, in a straight line."""
    headings: float
    """Steps of the heading a second."""


@borrowing_kernel
def lattice_motion_time(
    start: int, goal: int, n_headings: int, ny: int, speeds: LatticeSpeeds
) -> float:
    """Seconds from one pose id to another: it turns while it moves, so the longer of both.

    `ny` cells lie along y.
    """
    start_cell, goal_cell = start // n_headings, goal // n_headings
    dx, dy = goal_cell // ny - start_cell // ny, goal_cell % ny - start_cell % ny
    turn = abs(goal % n_headings - start % n_headings)
    turn = min(turn, n_headings - turn)
    return max(math.sqrt(float(dx * dx + dy * dy)) / speeds.cells, turn / speeds.headings)


@kernel
def write_motion_times(
    start: int,
    goals: NDArray[np.int64],
    n_headings: int,
    ny: int,
    speeds: tuple[float, float],
    out: NDArray[np.float64],
) -> None:
    """Write `lattice_motion_time` to each of some poses (k,); the speeds are a plain tuple."""
    named = LatticeSpeeds(speeds[0], speeds[1])
    for k in range(len(goals)):
        out[k] = lattice_motion_time(start, goals[k], n_headings, ny, named)
