import math
import sys
import zipfile
from importlib.util import find_spec

import numpy as np
import pytest
from plain.memory import memory_below

from coopmap_env.mapping import VoxelGrid
from coopmap_env.sensing import RangeNoise
from coopmap_env.studies.recorded import killian
from coopmap_env.studies.recorded.killian import (
    CellObservations,
    grid_for_log,
    held_out_loss,
    hold_out,
    observe_cells,
    scan_from_log,
)
from coopmap_env.studies.recorded.laser_log import LaserLog, LaserLogError, read_laser_log

NEEDS_DATA = pytest.mark.skipif(find_spec("rtbdata") is None, reason="needs the extra `data`")


def record(ranges, pose, start=-1.5, step=0.5, max_range=50.0, remissions=()):
    words = ["ROBOTLASER1", 0, start, 3.0, step, max_range, 0.1, 0, len(ranges), *ranges]
    words += [len(remissions), *remissions, *pose, 9, 9, 9, 0, 0, 0, 0, 0, 1e9, "host", 606.86]
    return " ".join(map(str, words))


@pytest.fixture
def zipped(tmp_path):
    def write(*lines, member="walk.g2o"):
        path = tmp_path / "walk.g2o.zip"
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr(member, "\n".join(lines))
        return path

    return write


def log_of(*ranges, poses=((0.0, 0.0, 0.0),), bearings=(0.0, math.pi / 2), max_range=50.0):
    return LaserLog(
        np.array(ranges, dtype=float), np.array(bearings), np.array(poses, dtype=float), max_range
    )


# The reader


def test_ranges_bearings_and_laser_poses_are_read_and_other_records_are_not(zipped):
    log = read_laser_log(
        zipped(
            "VERTEX_SE2 0 7 7 7",
            record([1.25, 2.5, 51.06], (1.0, 2.0, 0.5)),
            "",
            "EDGE_SE2 0 1 1 0 0 500 0 0 500 0 5000",
            record([3.0, 0.0, 4.0], (-1.0, 0.0, 3.0), remissions=[8, 8]),
            "# a remark",
        )
    )
    assert log.ranges.tolist() == [[1.25, 2.5, 51.06], [3.0, 0.0, 4.0]]
    assert log.poses.tolist() == [[1.0, 2.0, 0.5], [-1.0, 0.0, 3.0]]
    assert log.bearings.tolist() == [-1.5, -1.0, -0.5]
    assert log.max_range == 50.0
    assert log.angle_increment == 0.5


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            " ".join(record([1.0, 2.0], (0, 0, 0)).split()[:8]),
            "needs 9 words before its ranges, got 8",
        ),
        (" ".join(record([1.0, 2.0], (0, 0, 0)).split()[:13]), "cut short after 13 words"),
        (record([1.0, 2.0], (0, 0, 0)).replace(" 2 1.0", " 400 1.0"), "of 400 beams is cut short"),
        (
            record([1.0, 2.0], (0, 0, 0)).replace(" 2 1.0", " 2.0 1.0"),
            "number of values, got '2.0'",
        ),
        (record([1.0, 2.0], (0, 0, 0)).replace(" 2 1.0", " " + "9" * 5000), "number of values"),
        (
            record([1.0, 2.0], (0, 0, 0)).replace(" 2.0 0 ", " 2.0 -1 "),
            "number of values, got '-1'",
        ),
        (record([1.0] * 300_000, (0, 0, 0)), "longer than 1048576 bytes"),
        (record([1.0, 2.0], (0, math.inf, 0)), "a laser pose that is not finite"),
        (record([1.0, 2.0], (0, 0, 0), max_range=math.nan), "a header that is not finite"),
        (record([1.0, -2.0], (0, 0, 0)), "ranges >= 0"),
        (record([1.0, 2.0], (0, 0, 0), start=-90.0), "in radians of at most a full turn, got -90"),
        (record([1.0, 2.0], (0, 0, 0), step=1e308), "in radians of at most a full turn"),
        (record([1.0, "two"], (0, 0, 0)), "could not convert string to float"),
        (record([1.0], (0, 0, 0)), "two beams or more, got 1"),
        (record([1.0, 2.0, 3.0], (0, 0, 0)), "one log is one laser"),
    ],
)
def test_a_bad_record_is_named_with_its_file_and_line(zipped, line, message):
    path = zipped("# first", record([1.0, 2.0], (0, 0, 0)), line)
    with pytest.raises(LaserLogError, match=message) as error:
        read_laser_log(path)
    assert str(error.value).startswith(f"{path}, line 3: ")


def test_a_file_that_is_no_zip_is_rejected(tmp_path):
    path = tmp_path / "walk.g2o.zip"
    path.write_text("VERTEX_SE2 0 0 0 0")
    with pytest.raises(LaserLogError, match=r"walk\.g2o\.zip: not a ZIP archive"):
        read_laser_log(path)
    with pytest.raises(LaserLogError, match=r"missing\.zip: there is no such file"):
        read_laser_log(tmp_path / "missing.zip")


def test_a_zip_without_its_member_is_rejected(zipped):
    path = zipped(record([1.0, 2.0], (0, 0, 0)), member="run.g2o")
    with pytest.raises(LaserLogError, match=r"has no member walk\.g2o"):
        read_laser_log(path)


def test_a_file_without_scans_is_rejected(zipped):
    with pytest.raises(LaserLogError, match="no ROBOTLASER1 record"):
        read_laser_log(zipped("VERTEX_SE2 0 0 0 0"))


def test_lines_may_end_as_on_windows_and_records_may_be_indented_or_commented_out(zipped):
    one = record([1.0, 2.0], (0, 0, 0))
    log = read_laser_log(zipped(f"# {one}\r", f"  {one}\r", "ROBOTLASER10 1\r", f"{one}\r"))
    assert log.ranges.tolist() == [[1.0, 2.0], [1.0, 2.0]]


def test_ranges_without_a_distance_are_those_of_rep_117(zipped):
    log = read_laser_log(
        zipped(
            record([math.inf, 2.0, math.nan, -math.inf, 51.0], (0, 0, 0)),
            record([math.inf] * 5, (0, 0, 0)),
        )
    )
    np.testing.assert_array_equal(log.ranges[0], [math.inf, 2.0, math.nan, -math.inf, 51.0])
    # only the second beam returned: the others are skipped, as those beyond the max range are
    x, y = 2.0 * math.cos(-1.0), 2.0 * math.sin(-1.0)
    np.testing.assert_allclose(scan_from_log(log, 0).points, [[x, y]])
    assert len(scan_from_log(log, 1).points) == 0


def test_an_archive_of_very_many_lines_is_read_without_splitting_them(zipped):
    path = zipped("\n" * 20_000_000, record([1.0, 2.0], (0, 0, 0)), record([3.0], (0, 0, 0)))
    assert path.stat().st_size < 1e5
    with memory_below(100e6), pytest.raises(LaserLogError, match=r"line 20000003: .*two beams"):
        read_laser_log(path)


def test_a_log_larger_than_the_limits_is_rejected(zipped, monkeypatch):
    path = zipped(*[record([1.0, 2.0], (0, 0, 0))] * 9)
    monkeypatch.setenv("COOPMAP_MAX_CELLS", "17")
    with pytest.raises(LaserLogError, match=r"line 9: the log has 18 cells, more than .* of 17"):
        read_laser_log(path)
    monkeypatch.setenv("COOPMAP_MAX_CELLS", "18")
    assert read_laser_log(path).ranges.shape == (9, 2)
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "500")
    with pytest.raises(LaserLogError, match=r"the unpacked archive has .* bytes"):
        read_laser_log(path)


def test_poses_that_span_too_many_cells_are_rejected_with_their_size():
    far = log_of([1.0, 1.0], [1.0, 1.0], poses=[(0.0, 0.0, 0.0), (1e300, 0.0, 0.0)])
    with pytest.raises(ValueError, match=r"over 10\*\*15 cells, more than the limit"):
        grid_for_log(far)


# Scans


def test_the_points_of_a_rotated_laser_by_hand():
    log = log_of([2.0, 3.0], poses=[(10.0, 20.0, math.pi / 2)])
    scan = scan_from_log(log, 0)
    assert scan.origin.tolist() == [10.0, 20.0]
    # heading +y: the first beam goes up, the second, a quarter turn on, to the left
    np.testing.assert_allclose(scan.points, [[10.0, 22.0], [7.0, 20.0]], atol=1e-12)
    assert scan.hit.all()


def test_the_covariance_is_range_noise_along_and_the_width_of_the_beam_across():
    bearings = (0.0, 0.02)
    log = log_of([10.0, 10.0], poses=[(0.0, 0.0, math.pi / 2)], bearings=bearings)
    noise = RangeNoise(intrinsic=0.1, lateral=0.5, exponent=0)
    covariance = scan_from_log(log, 0, noise).covariances[0]
    # along is y here: 0.1 m; across is x: 0.05 m, and a beam 0.2 m wide at 10 m
    np.testing.assert_allclose(covariance, np.diag([0.05**2 + 0.2**2 / 12, 0.1**2]), atol=1e-12)


def test_no_returns_and_readings_beyond_the_usable_range_are_left_out():
    log = log_of([51.06, 4.0], [31.0, 29.0], [0.0, 50.0], poses=[(0, 0, 0)] * 3)
    assert len(scan_from_log(log, 0).points) == 1
    assert len(scan_from_log(log, 1).points) == 1
    assert len(scan_from_log(log, 1, usable_range=40.0).points) == 2
    assert len(scan_from_log(log, 2).points) == 0


@pytest.mark.parametrize("usable_range", [0.0, 50.5, math.nan])
def test_a_usable_range_beyond_the_laser_is_rejected(usable_range):
    with pytest.raises(ValueError, match="usable_range must lie in"):
        scan_from_log(log_of([1.0, 2.0]), 0, usable_range=usable_range)


def test_the_grid_contains_the_usable_range_of_every_pose():
    log = log_of([1, 1], [1, 1], poses=[(0.0, -3.0, 0.0), (7.3, 2.0, 1.0)])
    grid = killian.grid_for_log(log)
    reach = killian.USABLE_RANGE
    corners = [[-reach, -3.0 - reach], [7.3 + reach, 2.0 + reach]]
    assert grid.contains(grid.index(corners)).all()


# The held-out score


def test_every_tenth_scan_is_held_out():
    kept, held_out = hold_out(range(0, 60, 2), 10)
    assert held_out == [18, 38, 58]
    assert sorted(kept + held_out) == list(range(0, 60, 2))


def test_a_beam_observes_free_cells_before_its_end_and_an_occupied_cell_at_its_end():
    grid = VoxelGrid((6, 2), 0.5)
    # along +x from (0.25, 0.25) over 1.9 m: 3.8 cells from 0.5 on, to 4.3 in cell 4. It leaves
    # cells 0, 1, 2, 3 after 0.5, 1.5, 2.5, 3.5 cells; a cell before its end is 2.8.
    log = log_of([1.9, 0.5], poses=[(0.25, 0.25, 0.0)])
    seen = observe_cells(log, [0], grid)
    # the second beam goes up one cell, of which none is left early enough
    assert seen.cells.tolist() == [0, 2, 4, 8, 1]
    assert seen.occupied.tolist() == [False, False, False, True, True]


def test_no_scans_observe_nothing():
    seen = observe_cells(log_of([1.0, 2.0]), [], VoxelGrid((4, 4)))
    assert len(seen.cells) == len(seen.occupied) == 0


def test_the_held_out_loss_by_hand():
    probability = np.array([[0.1, 0.8], [0.5, 0.25]])
    seen = CellObservations(np.array([0, 0, 3, 1]), np.array([False, False, False, True]))
    loss = held_out_loss(probability, seen)
    free = -(2 * math.log(0.9) + math.log(0.75)) / 3
    hit = -math.log(0.8)
    assert loss["free"] == pytest.approx(free)
    assert loss["hit"] == pytest.approx(hit)
    assert loss["balanced"] == pytest.approx((free + hit) / 2)
    assert loss["all"] == pytest.approx((3 * free + hit) / 4)


def test_a_kind_without_observations_has_no_loss():
    loss = held_out_loss(np.array([[0.1]]), CellObservations(np.array([0]), np.array([False])))
    assert loss["free"] == loss["all"] == pytest.approx(-math.log(0.9))
    assert math.isnan(loss["hit"])
    assert math.isnan(loss["balanced"])


def corridor(n):
    """A laser that walks along a corridor 4 m wide, looking ahead."""
    bearings = np.radians(np.arange(-90, 90, 3))
    with np.errstate(divide="ignore"):
        ranges = np.minimum(2.0 / np.abs(np.sin(bearings)), 51.0)
    poses = np.column_stack([0.3 * np.arange(n), np.full(n, 0.05), np.zeros(n)])
    return LaserLog(np.tile(ranges, (n, 1)), bearings, poses, 50.0)


@pytest.fixture
def in_corridor(monkeypatch):
    monkeypatch.setattr(killian, "read_killian", lambda: corridor(60))


@pytest.mark.usefixtures("in_corridor")
def test_a_corridor_has_free_space_between_two_walls():
    result = killian.run_killian()
    assert result.scores["scans_fused"] == 54
    assert result.scores["scans_held_out"] == 6
    x_min, _, y_min, _ = result.extent
    column = int((5.1 - x_min) / result.resolution)
    rows = [int((y - y_min) / result.resolution) for y in (-1.95, -1.0, 0.0, 1.0, 2.05)]
    assert result.sampled[column, rows].all()
    lower, *free, upper = result.probability[column, rows]
    assert min(lower, upper) > 0.9
    assert max(free) < 0.1


@pytest.mark.usefixtures("in_corridor")
def test_scores_have_both_maps_and_are_deterministic():
    first, second = killian.run_killian(), killian.run_killian()
    assert first.scores == second.scores
    np.testing.assert_array_equal(first.probability, second.probability)
    for name in ("gaussian_beam", "hit_miss"):
        assert set(first.scores[name]) == {"all", "free", "hit", "balanced"}
        assert 0 < first.scores[name]["all"] < math.log(2)


@pytest.mark.usefixtures("in_corridor")
@pytest.mark.parametrize(
    ("stride", "message"), [(0, "at least 1, got 0"), (7, "fewer than 10 scans")]
)
def test_a_stride_without_held_out_scans_is_rejected(stride, message):
    with pytest.raises(ValueError, match=message):
        killian.run_killian(stride)


def test_without_its_data_killian_names_the_pip_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "rtbdata", None)
    with pytest.raises(ImportError, match=r"pip install 'coopmap\[data\]'"):
        killian.run_killian()


# The data


@NEEDS_DATA
def test_the_log_has_3873_scans_of_180_beams():
    log = killian.read_killian()
    assert log.ranges.shape == (3873, 180)
    assert log.poses.shape == (3873, 3)
    assert log.max_range == 50.0
    assert math.degrees(log.bearings[0]) == pytest.approx(-90.0, abs=1e-4)
    assert math.degrees(log.angle_increment) == pytest.approx(1.0, abs=1e-4)
    np.testing.assert_allclose(log.poses[0], [1.96, 37.867, -2.012385])


@NEEDS_DATA
def test_the_poses_close_their_loops():
    """What the robot saw 2,400 scans ago lies where it sees it now."""
    log = killian.read_killian()
    a, b = (scan_from_log(log, i, usable_range=10.0) for i in (1256, 3671))
    assert np.linalg.norm(a.origin - b.origin) < 1.0
    distance = np.linalg.norm(a.points[:, None] - b.points[None], axis=-1).min(axis=1)
    assert np.median(distance) < 0.1


@NEEDS_DATA
def test_the_beam_model_predicts_held_out_scans_better_than_constants():
    result = killian.run_killian(stride=6)
    ours, constant = result.scores["gaussian_beam"], result.scores["hit_miss"]
    assert result.scores["scans_fused"] == 582
    assert result.scores["scans_held_out"] == 64
    assert result.scores["unsampled_fraction"] < 0.03
    assert result.probability.shape == result.sampled.shape
    assert ours["all"] < constant["all"] < math.log(2)
