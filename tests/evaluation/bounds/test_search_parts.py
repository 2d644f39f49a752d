"""The parts of the search beside slow references: views in a frame, choices, active views."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from plain.small_worlds import SETTINGS, small_world
from plain.tiny_planar_views import plain_view

from coopmap_env.core.random_streams import stream_state
from coopmap_env.evaluation.bounds import BoundSearch, PlanarViews, bound_shown
from coopmap_env.evaluation.bounds._active_views import PARTS, minimise_bound
from coopmap_env.evaluation.bounds._planar_choices import FramedPoses, _list_view, _near_pose
from coopmap_env.evaluation.bounds._planar_frame import PlanarFrame
from coopmap_env.sensing import PlanarCamera


def make_views(n_beams=16, seed=0, n_scans=4):
    camera = PlanarCamera(depth_of_field=6.0, n_beams=n_beams)
    env = small_world(settings=replace(SETTINGS, camera=camera), max_scans=n_scans)
    env.reset(seed=seed)
    return PlanarViews.from_env(env)


def framed_poses(views, earliest=None):
    frame = views.frame
    if earliest is None:
        earliest = np.ones((1, views.occupied.size), dtype=np.int64)
    return FramedPoses(
        frame.around(-views.occupied.ravel().astype(np.int8), 0),
        frame.width,
        frame.around(views.known, True),
        frame.around(earliest, 100),
        np.zeros((1, 1), dtype=np.int64),
        np.ones((1, 1), dtype=np.int64),
    )


def test_by_hand_a_frame():
    frame = PlanarFrame((2, 3), 1)
    around = frame.around(np.arange(6), 9)
    assert around.reshape(4, 5).tolist() == [
        [9, 9, 9, 9, 9],
        [9, 0, 1, 2, 9],
        [9, 3, 4, 5, 9],
        [9, 9, 9, 9, 9],
    ]
    assert around[frame.framed(np.arange(6))].tolist() == [0, 1, 2, 3, 4, 5]
    assert frame.unframed(frame.framed(np.arange(6))).tolist() == [0, 1, 2, 3, 4, 5]
    assert frame.around(np.zeros((2, 6)), 1).shape == (2, 20)


@pytest.mark.parametrize("n_beams", [16, 100])
def test_the_list_without_branches_is_the_view_and_cells_of_the_frame(n_beams):
    views = make_views(n_beams)
    frame, poses = views.frame, framed_poses(views)
    fan, rng = frame.fan(views.fan), np.random.default_rng(0)
    inside = frame.around(np.ones(views.occupied.size, dtype=bool), False)
    alive = np.empty(len(fan.all_beams), np.uint64)
    cells = np.empty(fan.max_visible_cells + 1, np.int32)
    times = frame.around((rng.random(views.occupied.size) < 0.5).astype(np.int32), 1)
    for cell in rng.choice(views.cells, 30):
        heading = int(rng.integers(views.n_headings))
        pose = int(frame.framed(cell)) * views.n_headings + heading
        n, gain = _list_view(poses, pose, fan, alive, times, cells)
        seen = cells[:n][inside[cells[:n]]]
        assert len(set(cells[:n].tolist())) == n
        assert set(frame.unframed(seen).tolist()) == plain_view(
            views, cell * views.n_headings + heading
        )
        assert gain == (times[seen] == 0).sum()


def test_neighbours_are_near_possible_and_of_headings_side_by_side():
    views = make_views()
    frame, n_headings = views.frame, views.n_headings
    earliest = np.where(views.occupied.ravel(), 100, np.arange(views.occupied.size) % 5)[None]
    poses = framed_poses(views, earliest)
    stream, moves, turns = stream_state(np.random.SeedSequence(0)), set(), set()
    for cell in np.repeat(np.flatnonzero(earliest[0] <= 3), 10):
        pose = int(frame.framed(cell)) * n_headings + int(cell) % n_headings
        near = _near_pose(poses, 2, 0, pose, n_headings, stream)
        x, y = divmod(int(frame.unframed(near // n_headings)), 24)
        assert earliest[0, x * 24 + y] <= 3
        moves.add((x - cell // 24, y - cell % 24))
        turns.add((near - pose) % n_headings)
    assert moves == {(dx, dy) for dx in range(-3, 4) for dy in range(-3, 4)}
    assert turns == {0, 1, n_headings - 1}


def test_choices_are_possible_and_exchanges_show_more():
    for seed in range(3):
        views = make_views(seed=seed)
        shown = []
        for n_exchanges in (0, 500, 5_000):
            choice = views.choose(4, n_exchanges)
            assert views.can_take(choice)
            cells = set().union(*(plain_view(views, pose) for pose in choice.ravel()))
            shown.append(len(cells | set(np.flatnonzero(views.known).tolist())))
            np.testing.assert_array_equal(views.choose(4, n_exchanges), choice)
        assert shown[0] < shown[1] <= shown[2]


def test_what_cannot_be_taken_is_seen():
    views = make_views()
    choice = views.choose(4, 0)
    assert views.can_take(choice)
    late = views.cells[views.earliest[0] == 3] * views.n_headings
    occupied = np.flatnonzero(views.occupied.ravel()) * views.n_headings
    for pose in (-1, 2**60, late[0], occupied[0]):
        wrong = choice.copy()
        wrong[0, 0] = pose
        assert not views.can_take(wrong)
    choice[2, 0] = late[0]
    assert views.can_take(choice)


def plain_active_bound(sets, earliest, n_scans, known, weights):
    scores = np.array([weights[sets.cells[a:b]].sum() for a, b in pairwise(sets.start)])
    best = [
        max(scores[own <= scan], default=0.0) for own in earliest for scan in range(1, n_scans + 1)
    ]
    return (1.0 - weights[~known]).sum() + sum(best)


def test_the_bound_by_active_views_is_that_of_its_weights_and_falls():
    rng = np.random.default_rng(2)
    for seed in range(3):
        views = make_views(seed=seed)
        active = np.unique(rng.choice(views.cells, 40) * views.n_headings + 3)
        sets = views.pose_sets(active)
        earliest = np.ascontiguousarray(views.earliest[:, views.place_of(active)])
        weights = np.where(views.known, 0.0, rng.random(len(views.known)))
        rounding = len(weights) * 5 / PARTS
        before = plain_active_bound(sets, earliest, 4, views.known, weights)
        arguments = (*sets, earliest, 4, 50.0, views.known)
        assert minimise_bound(*arguments, 1, weights) == pytest.approx(before, abs=rounding)
        least = minimise_bound(*arguments, 300, weights)
        after = plain_active_bound(sets, earliest, 4, views.known, weights)
        assert least == pytest.approx(after, abs=rounding)
        assert after < 0.9 * before
        assert weights.min() >= 0.0
        assert weights.max() <= 1.0
        assert (weights[views.known] == 0.0).all()


def test_by_hand_two_views_that_share_half_of_their_cells():
    """Two scans of cells {0, 1} and {1, 2} show 3; trivially, they show 4. The weight of cell 1 is
    halved or less, and the weights of the others are 1."""
    start, cells = np.array([0, 2, 4]), np.array([0, 1, 1, 2], dtype=np.int32)
    weights = np.ones(3)
    earliest = np.array([[1, 1]])
    least = minimise_bound(start, cells, earliest, 2, 3.0, np.zeros(3, bool), 500, weights)
    assert least == pytest.approx(3.0, abs=0.01)


def test_a_log_receives_a_line_after_each_round():
    lines = []
    search = BoundSearch(n_rounds=2, n_exchanges=0, tolerance=0.0)
    bound_shown(make_views(n_scans=8), 8, search, lines.append)
    assert [line[:8] for line in lines] == ["round 1:", "round 2:"]
