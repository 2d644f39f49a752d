"""Cells that a camera will probably reach."""

import numpy as np
import pytest

from coopmap_env.mapping import VoxelGrid
from coopmap_env.robots import PoseLattice
from coopmap_env.robots.planar.feasible_poses import PoseSampling, is_within_reach, reach_square
from coopmap_env.robots.planar.likely_cells import likely_cells


@pytest.mark.parametrize("reach", [3.0, 100.0])
def test_paths_lead_through_likely_cells_near_by(reach):
    rng = np.random.default_rng(0)
    lattice = PoseLattice(VoxelGrid((14, 11)), 8)
    sampling = PoseSampling(lattice.geometry, (14, 11, 1), reach)
    for _ in range(40):
        free = rng.random(14 * 11).astype(np.float32)
        pose = int(rng.integers(lattice.n_poses))
        square = reach_square(pose, reach, lattice.geometry)
        x, y = square.cell_x, square.cell_y
        reached, grown = {(x, y)}, True
        while grown:
            beside = {
                (i + a, j + b) for i, j in reached for a, b in ((0, 1), (1, 0), (0, -1), (-1, 0))
            }
            new = {
                (i, j)
                for i, j in beside - reached
                if 0 <= i < 14
                and 0 <= j < 11
                and max(abs(i - x), abs(j - y)) <= square.half_side
                and free[i * 11 + j] >= 0.4
            }
            reached, grown = reached | new, bool(new)
        expected = {i * 11 + j for i, j in reached if is_within_reach(square, i - x, j - y)}
        found = likely_cells(free, 0.4, pose, sampling)
        assert len(found) == len(expected)
        assert set(found.tolist()) == expected
        assert found[0] == x * 11 + y
