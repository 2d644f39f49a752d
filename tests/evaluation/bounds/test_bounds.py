"""Upper bounds hold for every sequence of scans: enumerated, random, misled by noise."""

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from plain.planar_worlds import place_team
from plain.rollouts import random_actions
from plain.small_worlds import SETTINGS, small_world
from plain.tiny_planar_views import plain_view

from coopmap_env.evaluation.bounds import BoundSearch, Certificate, PlanarViews, bound_shown
from coopmap_env.evaluation.bounds.certificate import SCALE, best_by_scan
from coopmap_env.evaluation.bounds.planar_views import earliest_scans
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import Obstacles


def random_certificates(n_cells, rng):
    yield Certificate.trivial(n_cells)
    yield Certificate(np.zeros(n_cells, dtype=np.uint16))
    yield Certificate(rng.integers(SCALE + 1, size=n_cells).astype(np.uint16))
    yield Certificate((SCALE * (rng.random(n_cells) < 0.7)).astype(np.uint16))


def bits(cells):
    return np.uint64(sum(1 << int(cell) for cell in cells))


@pytest.mark.parametrize("n_beams", [16, 100])
@pytest.mark.parametrize("shape", [(24, 24), (9, 75)])  # less than a strip, and two and a part
def test_the_best_views_are_those_of_all_headings_counted_one_by_one(n_beams, shape):
    camera = PlanarCamera(depth_of_field=6.0, n_beams=n_beams)
    scene = Obstacles(shape=shape, side_min=2.0, side_max=4.0)
    env = small_world(scene=scene, settings=replace(SETTINGS, camera=camera))
    rng = np.random.default_rng(1)
    for seed in range(3):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env)
        weights = np.where(views.known, 0, rng.integers(SCALE + 1, size=len(views.known)))
        best = views.best(weights)
        places = np.append(rng.choice(len(views.cells), 25, replace=False), len(views.cells) - 1)
        for place in places:
            cell = views.cells[place]
            of_heading = [
                weights[list(plain_view(views, cell * views.n_headings + heading))].sum()
                for heading in range(views.n_headings)
            ]
            assert best.scores[place] == max(of_heading)
            assert best.poses[place] == cell * views.n_headings + int(np.argmax(of_heading))
        poses = best.poses[places]
        sets = views.pose_sets(poses)
        for k, pose in enumerate(poses):
            own = sets.cells[sets.start[k] : sets.start[k + 1]]
            assert len(own) == len(set(own.tolist()))
            assert set(own.tolist()) == plain_view(views, pose)
        np.testing.assert_array_equal(views.place_of(poses), places)


def test_by_hand_when_a_robot_can_be_where():
    """Jumps of 2 cells along a corridor with a wall at cell 4, which a jump passes."""
    occupied = np.zeros((10, 1), dtype=bool)
    occupied[4] = True
    found = earliest_scans(occupied, 1, 2.0, 3)
    assert found.ravel().tolist() == [1, 1, 1, 1, 4, 2, 3, 3, 4, 4]
    occupied[5] = True
    assert earliest_scans(occupied, 1, 2.0, 3).ravel().tolist() == [1, 1, 1, 1, 4, 4, 4, 4, 4, 4]


def test_by_hand_the_best_of_each_scan():
    best = best_by_scan(np.array([5, 9, 7]), np.array([[1, 3, 4], [2, 4, 4]]), 3)
    assert best.tolist() == [[5, 5, 9], [0, 5, 5]]


def test_no_choice_of_views_shows_more_than_any_certificate_says():
    """All choices of two scans of two robots in worlds of 64 cells, a bit for each."""
    camera = PlanarCamera(depth_of_field=3.0, n_beams=8)
    settings = replace(SETTINGS, camera=camera, n_headings=4, reach=1.0, max_start_distance=2.0)
    scene = Obstacles(shape=(8, 8), side_min=1.0, side_max=2.0)
    env = small_world(scene=scene, settings=settings, max_scans=2)
    rng = np.random.default_rng(0)
    for seed in range(4):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env)
        known = bits(np.flatnonzero(views.known))
        poses = (views.cells[:, None] * 4 + np.arange(4)).ravel()
        masks = np.array([bits(plain_view(views, pose)) for pose in poses])
        earliest = np.repeat(views.earliest, 4, axis=1)
        first, second = (
            np.unique([masks[a] | masks[b] | known for a, b in product(*can_be)])
            for can_be in ([np.flatnonzero(e <= scan) for e in earliest] for scan in (1, 2))
        )
        most = [
            int(np.bitwise_count(first).max()),
            max(int(np.bitwise_count(second | one).max()) for one in first),
        ]
        for certificate in random_certificates(len(views.known), rng):
            bounds = certificate.bounds(views, 2)
            assert bounds[0] >= views.known.sum()
            assert (bounds[1:] >= most).all()
        found = bound_shown(views, 2)
        assert (found.bounds[1:] >= most).all()
        assert found.choice_shown[-1] <= most[1]
        assert found.bounds[-1] <= 1.15 * most[1]  # near, not only above


@pytest.mark.parametrize("is_misled", [False, True])
def test_no_episode_shows_more_and_no_robot_comes_earlier(is_misled):
    """Random actions; where maps call all cells free, robots pass through walls and touch them."""
    env = small_world(max_scans=10, report_shown=True)
    rng = np.random.default_rng(3)
    n_collisions = 0
    for seed in range(12):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env)
        certificates = list(random_certificates(len(views.known), rng))
        bounds = [certificate.bounds(views, 10) for certificate in certificates]
        bounds.append(bound_shown(views, 10, BoundSearch(n_rounds=3, n_exchanges=20)).bounds)
        for scan in range(1, 11):
            if is_misled:
                env.belief().map.mark_free(np.arange(len(views.known)))
                place_team(env, env.belief().pose_ids)
            *_, infos = env.step(random_actions(env, rng))
            n_collisions += sum(info["collided"] for info in infos.values())
            shown = env.shown_mask.sum()
            assert all(shown <= bound[scan] for bound in bounds)
            for robot, pose_id in enumerate(env.belief().pose_ids):
                (place,) = views.place_of(np.array([pose_id]))
                assert views.cells[place] == pose_id // views.n_headings
                assert views.earliest[robot, place] <= scan
    assert (n_collisions > 10) == is_misled


def test_the_search_comes_near_and_its_certificates_say_so_again():
    env = small_world(scene=Obstacles(shape=(40, 40)), settings=None, max_scans=8)
    env.reset(seed=2)
    views = PlanarViews.from_env(env)
    found = bound_shown(views, 8)
    again = np.min([one.bounds(views, 8) for one in found.certificates], axis=0)
    np.testing.assert_array_equal(again, found.bounds)
    assert found.bounds.shape == found.choice_shown.shape == (9,)
    assert (found.choice_shown <= found.bounds).all()
    assert found.bounds[0] == found.choice_shown[0] == views.known.sum()
    assert 0.0 <= found.gap < 0.02
    trivial = Certificate.trivial(len(views.known)).bounds(views, 8)
    assert found.bounds[-1] < 0.95 * trivial[-1]
    for scan, poses in enumerate(found.choice, start=1):
        assert (views.earliest[np.arange(2), views.place_of(poses)] <= scan).all()
    other = bound_shown(views, 8)
    np.testing.assert_array_equal(other.choice, found.choice)
    np.testing.assert_array_equal(other.bounds, found.bounds)


def test_a_certificate_of_another_world_is_refused():
    env = small_world()
    env.reset(seed=0)
    views = PlanarViews.from_env(env)
    with pytest.raises(ValueError, match="needs 576 weights from 0 to 4096, got"):
        Certificate(np.zeros(5, dtype=np.uint16)).bounds(views, 4)
    with pytest.raises(ValueError, match="from 0 to 4097"):
        Certificate(np.full(576, SCALE + 1, dtype=np.uint16)).bounds(views, 4)


def test_a_camera_goes_into_the_corners_of_its_square_and_is_rounded_from_there():
    """A reach of 3.5 cells: corners are 4.95 cells away, and rounded to up to 5.66."""
    settings = replace(SETTINGS, reach=3.5)
    env = small_world(n_robots=1, settings=settings, max_scans=1)
    farthest = 0.0
    for seed in range(60):
        env.reset(seed=seed)
        views = PlanarViews.from_env(env)
        env.belief().map.mark_free(np.arange(len(views.known)))
        place_team(env, env.belief().pose_ids)
        start = env.belief().positions[0]
        turn = np.random.default_rng(seed).uniform(-1, 1)
        env.step({"robot_0": np.float32([1.0, (-1.0) ** seed, turn])})
        (pose_id,) = env.belief().pose_ids
        assert pose_id // views.n_headings in views.cells
        farthest = max(farthest, np.linalg.norm(env.belief().positions[0] - start))
    assert farthest > math.sqrt(2.0) * 3.5  # more than without the rounding


def test_more_scans_than_the_views_were_made_for_are_refused():
    env = small_world()
    env.reset(seed=0)
    views = PlanarViews.from_env(env, 3)
    bound_shown(views, 3, BoundSearch(n_rounds=0))
    for n_scans, message in ((4, "were made for 3 scans"), (0, "n_scans must be an integer")):
        with pytest.raises(ValueError, match=message):
            bound_shown(views, n_scans)
        with pytest.raises(ValueError, match=message):
            Certificate.trivial(len(views.known)).bounds(views, n_scans)
    for wrong in (0, -1, 2.5):
        with pytest.raises(ValueError, match="n_scans must be an integer of at least 1"):
            PlanarViews.from_env(env, wrong)


def test_views_of_something_else_are_refused():
    with pytest.raises(ValueError, match="a planar environment"):
        PlanarViews.from_env(object())
    far = Obstacles(shape=(24, 24), side_min=2.0, side_max=6.0, origin=(1e9, 0.0))
    env = small_world(scene=far)
    env.reset(seed=0)
    with pytest.raises(ValueError, match="too far away for a bound"):
        PlanarViews.from_env(env)


def test_scans_that_show_nothing_more_keep_the_bound_and_the_choice():
    """In 64 cells, many scans show all that can be shown: no more than there is."""
    scene = Obstacles(shape=(8, 8), side_min=1.0, side_max=2.0)
    settings = replace(SETTINGS, max_start_distance=2.0)
    env = small_world(scene=scene, settings=settings, max_scans=40)
    env.reset(seed=0)
    found = bound_shown(PlanarViews.from_env(env), 40)
    assert found.bounds[-1] <= 64
    assert found.choice_shown[-1] == found.choice_shown[20] <= found.bounds[20]


def test_views_are_those_of_the_start():
    env = small_world()
    env.reset(seed=0)
    env.step(random_actions(env, np.random.default_rng(0)))
    with pytest.raises(ValueError, match="reset it"):
        PlanarViews.from_env(env)


@pytest.mark.parametrize("field", ["n_rounds", "n_exchanges", "tolerance"])
def test_a_search_needs_sensible_numbers(field):
    with pytest.raises(ValueError, match=rf"BoundSearch.{field}"):
        BoundSearch(**{field: -1})
