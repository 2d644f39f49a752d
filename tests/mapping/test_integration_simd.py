"""The fast 3-D kernel of partial surfaces equals the general one, to the last bit."""

import numpy as np
import pytest
from plain.random_scans import random_scan

from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.integration_scalar import allocate_beam, integrate_rays
from coopmap_env.mapping.integration_simd import integrate_rays_simd
from coopmap_env.sensing import Scan

GRID = VoxelGrid((11, 9, 8), 0.25, (0.5, -1.0, 2.0))


def integrated(kernel, scan, model, grid):
    """Updates, listed cells and the cells of the points after the rays of one scan."""
    buffers = UpdateBuffers.empty(grid.n_cells)
    hit_cells = np.empty(len(scan.points), dtype=np.int64)
    count = kernel(scan.arrays, grid.geometry, model.parameters, buffers, hit_cells)
    return buffers.pending, buffers.updated_cells[:count], hit_cells


def integrate_one_by_one(scan, grid, beam, buffers, hit_cells):
    """`integrate_rays` with scratch of its own."""
    scratch = allocate_beam(grid.shape, 3)
    return integrate_rays(scan, grid, beam, scratch, buffers, hit_cells)


@pytest.mark.parametrize("largest_sigma", [0.0, 0.1, 1.2, 6.0])
@pytest.mark.parametrize(
    "constants", [(0.001, 0.998), (0.2, 0.7), (0.01, 0.998, 0.95, 0.99), (0.01, 0.9, 0.8, 0.5)]
)
def test_both_kernels_agree_bit_by_bit(largest_sigma, constants):
    rng = np.random.default_rng(0)
    free, occupied, *rest = constants
    model = BeamModel(free, occupied, "partial", *rest)
    for n_beams in [3, 8, 40] * 25:
        scan = random_scan(rng, GRID, n_beams, largest_sigma)
        fast, general = (
            integrated(kernel, scan, model, GRID)
            for kernel in (integrate_rays_simd, integrate_one_by_one)
        )
        for one, other in zip(fast, general, strict=True):
            np.testing.assert_array_equal(one, other)


def test_a_cell_that_keeps_a_point_is_one_that_was_sampled():
    """Whatever the update: clearing the map resets sampled cells."""
    rng = np.random.default_rng(1)
    map_ = OccupancyMap(GRID, BeamModel(0.2, 0.7, "partial"))
    for _ in range(200):
        map_.integrate(random_scan(rng, GRID, 10, 3.0))
    cells, _, _ = map_.surfaces()
    assert len(cells) > 100
    assert (map_.sampled_mask[cells] == 1).all()
    map_.clear()
    assert not map_.surface_sums.precision.any()


def test_the_order_of_the_beams_does_not_change_the_updates():
    rng = np.random.default_rng(2)
    model = BeamModel(0.02, 0.998, "partial")
    for _ in range(10):
        scan = random_scan(rng, GRID, 60)
        order = rng.permutation(60)
        again = Scan(scan.origin, scan.points[order], scan.covariances[order], scan.hit[order])
        one, other = (
            integrated(integrate_rays_simd, scan, model, GRID),
            integrated(integrate_rays_simd, again, model, GRID),
        )
        np.testing.assert_array_equal(one[0], other[0])
        assert sorted(one[1]) == sorted(other[1])
        np.testing.assert_array_equal(one[2][order], other[2])
