"""The map: what scans do to it, and what they must not."""

import functools
import itertools
import math

import numpy as np
import pytest
from plain.fusion import PlainMap
from plain.random_scans import random_scan

from coopmap_env.mapping import (
    BeamModel,
    LogOddsRange,
    OccupancyMap,
    SurfaceArrays,
    VoxelGrid,
    merge_gaussians,
    occupancy_map,
    to_log_odds_fixed,
)
from coopmap_env.mapping.arrays import MapStorage
from coopmap_env.sensing import PlanarCamera, RangeNoise, Scan
from coopmap_env.simulation import PlanarSimulator
from coopmap_env.simulation.scenes.planar import PlanarWorld

GRIDS = [
    pytest.param(VoxelGrid((14, 11), 0.5, (-2.0, 1.0)), id="2-D"),
    pytest.param(VoxelGrid((9, 7, 8), 0.25, (0.5, -1.0, 2.0)), id="3-D"),
]
SURFACE = pytest.mark.parametrize("surface", ["entry", "anywhere"])
MODEL = BeamModel(free=0.01, occupied=0.97)
LOWEST, HIGHEST = MODEL.log_odds_bounds


def row(n=12):
    """A map of one row of n cells of one metre."""
    return OccupancyMap(VoxelGrid((n, 1)), MODEL)


def scan_along(distance, sigma=0.0, hit=True, start=0.5):
    """One beam along the row."""
    return Scan(
        np.array([start, 0.5]),
        np.array([[start + distance, 0.5]]),
        np.array([np.diag([sigma**2, 0.0])]),
        np.array([hit]),
    )


def state(map_):
    return tuple(
        array.tobytes()
        for array in (
            map_.log_odds_fixed,
            map_.sampled_mask,
            map_.hit_cells,
            *map_.hit_cell_sums()[1],
            map_._buffers.pending,
        )
    )


def random_map(grid, seed=0, n_scans=6, **arguments):
    rng = np.random.default_rng(seed)
    map_ = OccupancyMap(grid, **arguments)
    for _ in range(n_scans):
        map_.integrate(random_scan(rng, grid))
    return map_


@pytest.mark.parametrize("fusion", ["eq_4", "mean"])
def test_rows_of_surfaces_for_hit_cells_alone_hold_what_rows_for_all_cells_hold(
    fusion, monkeypatch
):
    """Whatever the number of rows to begin with, and after the map was cleared."""
    monkeypatch.setattr(occupancy_map, "FIRST_ROWS", 2)
    grid, model = VoxelGrid((9, 7, 8), 0.25), BeamModel(surface_fusion=fusion)
    n = grid.n_cells
    sums = SurfaceArrays.empty(n, 3, fusion == "mean")
    storage = MapStorage(np.zeros(n, np.int32), np.zeros(n, np.uint8), sums)
    own, given = OccupancyMap(grid, model), OccupancyMap(grid, model, storage=storage)
    rng = np.random.default_rng(0)
    for _ in range(2):
        for _ in range(4):
            scan = random_scan(rng, grid, 60)
            assert own.integrate(scan) == given.integrate(scan)
        (cells, mine), (given_cells, theirs) = own.hit_cell_sums(), given.hit_cell_sums()
        assert len(cells) > 2 * 2
        np.testing.assert_array_equal(cells, given_cells)
        for one, other in zip(mine, theirs, strict=True):
            np.testing.assert_array_equal(one, other)
        assert len(own.surface_sums.precision) < n == len(given.surface_sums.precision)
        own.clear()
        given.clear()
        assert len(own.hit_cells) == len(given.hit_cells) == 0


def test_a_new_map_knows_nothing():
    map_ = OccupancyMap(VoxelGrid((4, 5)))
    assert (map_.probability == 0.5).all()
    assert not map_.sampled.any()
    assert map_.entropy == pytest.approx(20 * math.log(2))
    assert map_.observed_fraction == 0
    assert len(map_.surfaces()[0]) == 0


def test_one_sharp_beam_makes_cells_free_occupied_and_leaves_the_rest_unknown():
    map_ = row()
    (gain,) = map_.integrate(scan_along(4.5))  # the face of cell 5
    p = map_.probability[:, 0]
    # one fixed-point step is 1/1024 nat
    assert p[:5] == pytest.approx([0.01] * 5, rel=1e-3)
    assert p[5] == pytest.approx(0.97, rel=1e-3)
    assert (p[6:] == 0.5).all()
    assert map_.sampled[:, 0].tolist() == [True] * 6 + [False] * 6
    assert gain.new_cells == 6
    assert map_.observed_fraction == 0.5


def test_one_sharp_beam_leaves_its_point_as_the_surface():
    map_ = row()
    map_.integrate(scan_along(4.5))
    cells, means, covariances = map_.surfaces()
    assert cells.tolist() == [5]
    assert means == pytest.approx(np.array([[5.0, 0.5]]))
    # no observation is trusted beyond a hundredth of a cell
    assert covariances == pytest.approx(np.array([np.diag([1e-4, 1e-4])]))


def test_a_beam_without_return_frees_the_cells_up_to_its_end():
    map_ = row()
    map_.integrate(scan_along(4.0, hit=False))
    assert (map_.log_odds[:5, 0] == LOWEST / 1024).all()
    assert not map_.sampled[5:].any()
    assert len(map_.surfaces()[0]) == 0


def test_a_blurred_beam_spreads_the_surface_over_cells_by_the_beam_model():
    map_ = row()
    map_.integrate(scan_along(4.5, sigma=0.4))
    # faces 4, 5, 6 lie 2.5, 0, 2.5 sigma away: 1/1, 1/2, 1/4 times e^-3.125, 1, e^-3.125
    side = math.exp(-3.125)
    total = side + 0.5 + 0.25 * side
    p = map_.probability[3:8, 0]
    expected = [0.01, side / total, (0.5 + 0.5 * side) / total]
    assert p[:3] == pytest.approx(expected, rel=2e-3)
    assert (p[3:] >= 0.5).all()


def test_scans_add_their_log_odds_until_the_clamp():
    map_ = row()
    for n in range(1, 4):
        map_.integrate(scan_along(4.5))
        assert map_.log_odds[5, 0] == min(n * HIGHEST, to_log_odds_fixed(0.999)) / 1024
    assert map_.probability[5, 0] == pytest.approx(0.999, rel=1e-4)
    assert map_.probability[0, 0] == pytest.approx(0.001, rel=1e-2)


def test_after_many_scans_the_clamp_lets_one_contradiction_or_two_change_a_cell():
    map_ = row()
    for _ in range(50):
        map_.integrate(scan_along(9.0, hit=False))
    assert map_.probability[5, 0] < 0.01
    map_.integrate([scan_along(4.5), scan_along(4.5), scan_along(4.5)])
    assert map_.probability[5, 0] > 0.5


def test_a_cell_is_updated_once_per_scan_however_many_beams_cross_it():
    one, many = row(), row()
    scan = scan_along(4.0, hit=False)
    one.integrate(scan)
    many.integrate(
        Scan(
            scan.origin,
            np.repeat(scan.points, 30, axis=0),
            np.repeat(scan.covariances, 30, axis=0),
            np.repeat(scan.hit, 30),
        )
    )
    assert (one.log_odds_fixed == many.log_odds_fixed).all()


def test_beams_that_disagree_within_a_scan_are_summed_before_the_bounds():
    map_ = row()
    scan = scan_along(4.5)
    through = scan_along(8.0, hit=False)
    map_.integrate(
        Scan(
            scan.origin,
            np.concatenate([scan.points, through.points]),
            np.concatenate([scan.covariances, through.covariances]),
            np.array([True, False]),
        )
    )
    assert map_.log_odds_fixed[5] == HIGHEST + LOWEST


def test_beams_that_cancel_each_other_list_their_cell_once():
    """The sum is kept one step off zero, which marks cells that the scan does not cross."""
    map_ = OccupancyMap(VoxelGrid((12, 1)), BeamModel(free=0.1, occupied=0.9))
    wall, through = scan_along(4.5), scan_along(8.0, hit=False)
    n = 200
    (gain,) = map_.integrate(
        Scan(
            wall.origin,
            np.tile(np.concatenate([wall.points, through.points]), (n, 1)),
            np.tile(np.concatenate([wall.covariances, through.covariances]), (n, 1, 1)),
            np.tile([True, False], n),
        )
    )
    assert map_.log_odds_fixed[5] == 1
    assert gain.new_cells == 9


@SURFACE
@pytest.mark.parametrize("grid", GRIDS)
@pytest.mark.parametrize("behind", [(0.5, 0.95), (0.93, 0.99)])
def test_integrating_is_what_the_plain_loops_do(grid, surface, behind):
    rng = np.random.default_rng(7)
    model = BeamModel(0.4, 0.99, surface, *behind)
    map_ = OccupancyMap(grid, model, LogOddsRange(0.97))
    plain = PlainMap(grid, model, map_.log_odds_range.clamp)
    for n_beams in [4, 8, 24] * 9:
        scan = random_scan(rng, grid, n_beams)
        (gain,) = map_.integrate(scan)
        new, drop = plain.integrate(scan)
        # integers: exactly equal
        assert (map_.log_odds_fixed.reshape(grid.shape) == plain.log_odds_fixed).all()
        assert (map_.sampled == plain.sampled).all()
        assert gain.new_cells == new
        # sums of some hundred terms of at most ln 2
        assert gain.entropy_reduction == pytest.approx(drop, abs=1e-9)
        assert not map_._buffers.pending.any()
    assert plain.log_odds_fixed.min() == -map_.log_odds_range.clamp
    assert plain.log_odds_fixed.max() == map_.log_odds_range.clamp


@pytest.mark.parametrize("grid", GRIDS)
def test_surfaces_are_the_hits_of_each_cell_merged_one_by_one_eq_4(grid):
    rng = np.random.default_rng(8)
    map_ = OccupancyMap(grid, MODEL)
    plain = PlainMap(grid, MODEL, map_.log_odds_range.clamp)
    for _ in range(25):
        scan = random_scan(rng, grid)
        map_.integrate(scan)
        plain.integrate(scan)
    cells, means, covariances = map_.surfaces()
    assert [int(grid.flat_index(cell)) for cell in sorted(plain.observations)] == cells.tolist()
    for cell, mean, C in zip(cells, means, covariances, strict=True):
        index = tuple(int(i) for i in np.unravel_index(cell, grid.shape))
        merged, C_merged = functools.reduce(
            lambda a, b: merge_gaussians(*a, *b), plain.observations[index]
        )
        # the precisions reach 1e5 per square metre: five of sixteen digits go into the inverses
        assert mean == pytest.approx(merged, abs=1e-8)
        assert pytest.approx(C_merged, abs=1e-8) == C
    assert max(map(len, plain.observations.values())) > 1


@pytest.mark.parametrize("grid", GRIDS)
def test_the_order_of_the_scans_of_one_call_does_not_change_the_map(grid):
    rng = np.random.default_rng(9)
    start = random_map(grid, seed=10, n_scans=3)
    scans = [random_scan(rng, grid) for _ in range(4)]
    results = []
    for order in itertools.permutations(scans):
        map_ = start.copy()
        gains = map_.integrate(order)
        results.append(
            (map_, sum(g.new_cells for g in gains), sum(g.entropy_reduction for g in gains))
        )
    first, new, drop = results[0]
    for map_, new_, drop_ in results[1:]:
        assert (map_.log_odds_fixed == first.log_odds_fixed).all()
        assert (map_.probability == first.probability).all()
        assert (map_.sampled == first.sampled).all()
        assert new_ == new
        assert drop_ == pytest.approx(drop, abs=1e-9)
        # information is summed in another order, in floating point
        for mine, theirs in zip(map_.surfaces(), first.surfaces(), strict=True):
            assert mine == pytest.approx(theirs, abs=1e-9)


def test_scans_of_one_call_are_clamped_together_at_its_end():
    """Two scans for and one against: clamped after each, the result would depend on the order."""
    wall, through = scan_along(4.5), scan_along(8.0, hit=False)
    map_ = OccupancyMap(VoxelGrid((12, 1)), MODEL, LogOddsRange(0.98))
    map_.integrate([wall, wall, through])
    assert map_.log_odds_fixed[5] == 2 * HIGHEST + LOWEST


@pytest.mark.parametrize("grid", GRIDS)
def test_entropy_reductions_add_up_to_that_of_the_map(grid):
    rng = np.random.default_rng(11)
    map_ = OccupancyMap(grid)
    for _ in range(10):
        before = map_.entropy
        seen = np.count_nonzero(map_.sampled)
        gains = map_.integrate([random_scan(rng, grid) for _ in range(3)])
        # sums of some hundred terms of at most ln 2
        assert sum(g.entropy_reduction for g in gains) == pytest.approx(
            before - map_.entropy, abs=1e-9
        )
        assert sum(g.new_cells for g in gains) == np.count_nonzero(map_.sampled) - seen


def test_a_contradiction_raises_the_entropy():
    map_ = row()
    map_.integrate(scan_along(9.0, hit=False))
    (gain,) = map_.integrate(scan_along(4.5))
    assert map_.entropy > 0
    assert gain.entropy_reduction < math.log(2)
    assert gain.new_cells == 0


@pytest.mark.parametrize("grid", GRIDS)
def test_probabilities_stay_inside_the_clamp_and_one_half_where_not_sampled(grid):
    map_ = random_map(grid, seed=12, n_scans=15, log_odds_range=LogOddsRange(0.98))
    p = map_.probability
    # one fixed-point step is 1/1024 nat
    assert p.min() == pytest.approx(0.02, rel=1e-3)
    assert p.max() < 0.98 * (1 + 1e-3)
    assert p.shape == map_.sampled.shape == grid.shape
    assert (p[~map_.sampled] == 0.5).all()
    assert map_.log_odds == pytest.approx(np.log(p / (1 - p)))
    entropies = -p * np.log(p) - (1 - p) * np.log(1 - p)
    assert map_.entropy == pytest.approx(entropies.sum())
    assert map_.observed_fraction == map_.sampled.mean()


def test_the_observed_fraction_follows_every_change_of_the_map():
    map_ = OccupancyMap(VoxelGrid((6, 5)))
    assert map_.observed_fraction == 0.0
    map_.mark_free([3, 4])
    assert map_.observed_fraction == 2 / 30
    map_.mark_occupied([4, 5])
    assert map_.observed_fraction == 3 / 30
    hit, covariances = np.array([True]), np.full((1, 2, 2), 0.01)
    for end in ([3.5, 0.5], [3.5, 2.5]):
        scan = Scan(np.array([0.5, 0.5]), np.array([end]), covariances, hit)
        map_.integrate([scan, scan])
        assert map_.observed_fraction == map_.sampled.mean()
    map_.sampled_mask[-1] = 1
    map_.cells_changed()
    assert map_.observed_fraction == map_.sampled.mean()
    map_.clear()
    assert map_.observed_fraction == 0.0


def test_a_cell_may_be_sampled_and_still_be_at_one_half():
    """Eq. 8 asks whether a voxel was ever sampled, which p alone does not tell."""
    map_ = OccupancyMap(VoxelGrid((12, 1)), BeamModel(free=0.1, occupied=0.9))
    map_.integrate([scan_along(4.5), scan_along(8.0, hit=False)])
    assert map_.probability[5, 0] == 0.5
    assert map_.sampled[5, 0]
    assert not map_.sampled[9, 0]


def test_a_hit_far_beyond_the_grid_frees_the_path_to_the_border_and_leaves_no_surface():
    map_ = row()
    map_.integrate(scan_along(40.0, sigma=0.5))
    assert (map_.log_odds_fixed == LOWEST).all()
    assert len(map_.surfaces()[0]) == 0


@SURFACE
def test_a_wall_at_the_border_is_not_freed_by_noise_that_carries_hits_beyond_it(surface):
    """The last cell may have ended the beam as well as what comes after the border."""
    map_ = OccupancyMap(VoxelGrid((12, 1)), BeamModel(surface=surface))
    map_.integrate(scan_along(12.0, sigma=0.9))
    assert map_.probability[11, 0] > 0.2
    assert map_.log_odds_fixed[0] == map_.model.log_odds_bounds[0]


def test_walls_at_the_border_are_mapped_as_free_as_rarely_as_any_others():
    occupied = np.zeros((32, 8), dtype=bool)
    occupied[25:] = True
    camera = PlanarCamera(field_of_view=1e-3, depth_of_field=30.0, n_beams=1)
    rng = np.random.default_rng(13)
    freed = []
    for n in (26, 32):
        simulator = PlanarSimulator(
            PlanarWorld(occupied[:n], 1.0, (0.0, 0.0), ""), camera, RangeNoise()
        )
        p = []
        for _ in range(1000):
            map_ = OccupancyMap(VoxelGrid((n, 8)))
            map_.integrate(simulator.scan_from((0.5, 4.5, 0.0), rng))
            p.append(map_.probability[25, 4])
        freed.append(np.mean(np.array(p) < 0.05))
    # one scan at 0.9 cells of noise: more than 2.5 sigma too far happens in 0.6 % of the scans
    assert max(freed) < 0.01


def test_beams_without_length_change_nothing():
    map_ = row()
    (gain,) = map_.integrate(scan_along(0.0, sigma=0.1))
    assert gain.new_cells == 0
    assert not map_.sampled.any()
    assert map_.integrate(scan_along(0.0, hit=False))[0].entropy_reduction == 0


def test_a_camera_in_the_lower_corner_may_point_out_of_the_grid():
    map_ = OccupancyMap(VoxelGrid((4, 4)))
    scan = Scan(np.zeros(2), np.full((1, 2), -3.0), np.zeros((1, 2, 2)), np.array([True]))
    (gain,) = map_.integrate(scan)
    assert gain.new_cells == 0


def test_no_uncertainty_along_the_beam_is_as_good_as_the_least():
    """A covariance across the beam only: rounding must not take its variance below zero."""
    grid = VoxelGrid((20, 20))
    rng = np.random.default_rng(14)
    for angle in rng.uniform(0, 2 * np.pi, 300):
        u = np.array([math.cos(angle), math.sin(angle)])
        across = np.array([-u[1], u[0]])
        origin = np.array([10.2, 9.7])
        map_ = OccupancyMap(grid)
        map_.integrate(
            Scan(
                origin,
                (origin + 7 * u)[None],
                0.3 * np.outer(across, across)[None],
                np.ones(1, bool),
            )
        )
        assert map_.log_odds_fixed.max() > 0
        assert len(map_.surfaces()[0]) == 1


def test_no_scans_change_nothing():
    map_ = row()
    before = state(map_)
    assert map_.integrate([]) == []
    empty = Scan(np.full(2, 0.5), np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0, bool))
    assert map_.integrate(empty)[0].new_cells == 0
    assert state(map_) == before


def broken(scan, **arguments):
    arrays = {"origin": scan.origin, "points": scan.points, "covariances": scan.covariances}
    return Scan(**{**arrays, "hit": scan.hit, **arguments})


def bad_scans():
    good = scan_along(4.5, sigma=0.1)
    nan = np.array([[math.nan, 0.5]])
    yield (
        "3-D scan",
        broken(good, origin=np.zeros(3), points=np.ones((1, 3)), covariances=np.zeros((1, 3, 3))),
    )
    yield "outside", broken(good, origin=np.array([12.0, 0.5]))
    yield "outside", broken(good, origin=np.array([0.5, -0.1]))
    yield "outside", broken(good, origin=np.array([math.nan, 0.5]))
    yield "beam 0 .*not finite", broken(good, points=nan)
    yield "beam 0 .*not finite", broken(good, points=nan, hit=np.array([False]))
    yield "beam 0 .*not finite", broken(good, points=np.array([[math.inf, -math.inf]]))
    yield "beam 0 .*not finite", broken(good, covariances=np.full((1, 2, 2), math.nan))


@pytest.mark.parametrize(("message", "scan"), list(bad_scans()))
def test_an_invalid_scan_is_rejected_and_the_map_is_unchanged(message, scan):
    map_ = row()
    map_.integrate(scan_along(3.3, sigma=0.3))
    before = state(map_)
    with pytest.raises(ValueError, match=message):
        map_.integrate([scan_along(4.5), scan])
    assert state(map_) == before


def test_the_beam_that_is_not_finite_is_named():
    covariances = np.zeros((3, 2, 2))
    covariances[2, 0, 1] = math.nan
    scan = Scan(np.full(2, 0.5), np.ones((3, 2)), covariances, np.ones(3, bool))
    with pytest.raises(ValueError, match="beam 2 "):
        row().integrate(scan)


def test_the_covariance_of_a_beam_without_return_is_not_read():
    map_, plain = row(), row()
    scan = scan_along(4.0, hit=False)
    plain.integrate(scan)
    map_.integrate(broken(scan, covariances=np.full((1, 2, 2), math.nan)))
    assert (map_.log_odds_fixed == plain.log_odds_fixed).all()


@pytest.mark.parametrize("grid", GRIDS)
def test_a_cleared_map_is_a_new_map(grid):
    map_ = random_map(grid, seed=15)
    map_.clear()
    assert state(map_) == state(OccupancyMap(grid))
    scan = random_scan(np.random.default_rng(16), grid)
    new = OccupancyMap(grid)
    assert map_.integrate(scan) == new.integrate(scan)
    assert state(map_) == state(new)


def test_a_copy_is_independent():
    grid = VoxelGrid((14, 11))
    map_ = random_map(grid, seed=17)
    before = state(map_)
    copy = map_.copy()
    assert state(copy) == before
    copy.integrate(random_scan(np.random.default_rng(18), grid))
    assert state(map_) == before
    assert state(copy) != before


def test_cells_marked_free_are_sampled_and_as_free_as_can_be():
    map_ = OccupancyMap(VoxelGrid((4, 3)))
    map_.mark_free([1, 5])
    assert map_.sampled.sum() == 2
    assert map_.probability[0, 1] == map_.probability[1, 2] == map_.log_odds_range.probability[0]
    assert map_.observed_fraction == pytest.approx(1 / 6)


def test_a_noise_free_camera_maps_its_world_as_it_is():
    """RangeNoise(intrinsic=0), from simulator to surfaces: every hit cell is a true wall."""
    rng = np.random.default_rng(19)
    occupied = rng.random((30, 30)) < 0.15
    occupied[14:17, 14:17] = False
    world = PlanarWorld(occupied, 0.5, (-3.0, 2.0), "")
    camera = PlanarCamera(depth_of_field=8.0)
    simulator = PlanarSimulator(world, camera, RangeNoise(intrinsic=0.0))
    map_ = OccupancyMap(VoxelGrid(world.shape, world.resolution, world.origin))
    for heading in np.arange(0, 2 * np.pi, np.pi / 4):
        map_.integrate(simulator.scan_from((4.7, 9.8, heading), rng))
    assert (map_.probability[map_.sampled & occupied] > 0.5).all()
    assert (map_.probability[map_.sampled & ~occupied] < 0.05).mean() > 0.98
    cells, means, covariances = map_.surfaces()
    assert len(cells) > 20
    # every surface point lies on a wall, or in it where two faces merged, or no further than three
    # times the least sigma before it: a cell whose corner the beam cut by less than that explains
    # the distance as well as the wall
    walls = map_.grid.center(np.argwhere(occupied))
    gaps = np.abs(means[:, None] - walls).max(axis=2).min(axis=1) - 0.5 * world.resolution
    assert gaps.max() < 3 * 0.01 * world.resolution
    assert occupied.ravel()[cells].mean() > 0.9
    assert np.linalg.eigvalsh(covariances).max() <= (0.01 * world.resolution) ** 2 * (1 + 1e-6)
