"""The gain of a view from projected ellipsoids."""

import math

import numpy as np
import pytest
from plain.planar_worlds import NO_NOISE, env_with_world, open_world, set_poses
from plain.random_maps import set_cells

import coopmap_baselines
from coopmap_baselines.projection import BLOCK, Ellipsoids, ellipsoids, projected_fraction
from coopmap_env.envs import CameraFrames
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.sensing import PlanarCamera

TANGENT = math.tan(math.radians(30.0))
NOTHING = {d: Ellipsoids(np.empty((0, d)), np.empty((0, d, d))) for d in (2, 3)}


def camera(dimension):
    """One at the origin that looks along x."""
    return CameraFrames(
        np.eye(dimension)[None],
        np.zeros((1, dimension)),
        np.full(dimension - 1, TANGENT),
        0.0,
        20.0,
    )


def test_cells_of_a_group_and_a_block_become_one_ellipsoid():
    cells = np.array([[0, 0], [1, 0], [2, 0], [BLOCK, 0], [0, 1]])
    found = ellipsoids(cells + 0.5, np.array([1, 1, 1, 1, 2]), 1.0)
    np.testing.assert_allclose(found.means, [[1.5, 0.5], [BLOCK + 0.5, 0.5], [0.5, 1.5]])
    one = np.eye(2) / 12  # of a cell
    np.testing.assert_allclose(found.covariances[0], one + np.diag([2 / 3, 0]))
    np.testing.assert_allclose(found.covariances[1:], [one, one])


def test_a_wall_of_frontier_across_the_view_covers_its_part_of_it():
    # 4 m wide, evenly filled, 10 m ahead: half of the range is left behind it
    wall = Ellipsoids(np.array([[10.0, 0.0]]), np.diag([0.0, 4.0**2 / 12])[None])
    expected = 0.5 * (4.0 / 10.0) / (2 * TANGENT)
    assert projected_fraction(camera(2), wall, NOTHING[2])[0] == pytest.approx(expected)


def test_a_disc_of_frontier_covers_its_area_of_an_image():
    # radius 2 m: evenly filled, its variance along an axis is r^2 / 4
    disc = Ellipsoids(np.array([[10.0, 0.0, 0.0]]), np.diag([0.0, 1.0, 1.0])[None])
    expected = 0.5 * math.pi * (2.0 / 10.0) ** 2 / (2 * TANGENT) ** 2
    assert projected_fraction(camera(3), disc, NOTHING[3])[0] == pytest.approx(expected)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_surface_hides_what_is_behind_it_and_only_that(dimension):
    round_ = np.eye(dimension)[None] * 0.25

    def at(*point):
        return Ellipsoids(np.array([[*point, 0.0][:dimension]]), round_)

    behind = at(10.0, 0.0)
    free = projected_fraction(camera(dimension), behind, NOTHING[dimension])
    assert free[0] > 0
    assert projected_fraction(camera(dimension), behind, at(5.0, 0.0))[0] == 0
    assert projected_fraction(camera(dimension), behind, at(12.0, 0.0)) == free
    assert projected_fraction(camera(dimension), behind, at(5.0, 3.0)) == free
    assert projected_fraction(camera(dimension), behind, at(-5.0, 0.0)) == free


@pytest.mark.parametrize("point", [[-10.0, 0.0], [5.0, 4.0], [25.0, 0.0]])
def test_what_is_out_of_view_or_out_of_range_counts_nothing(point):
    there = Ellipsoids(np.array([point]), np.eye(2)[None])
    assert projected_fraction(camera(2), there, NOTHING[2])[0] == 0


def test_the_view_turns_to_the_frontier_and_not_to_the_wall():
    env = env_with_world(open_world(), n_robots=1, settings=PlanarSettings(noise=NO_NOISE))
    known = np.zeros((40, 40), dtype=bool)
    known[15:26, 15:26] = True
    belief = set_poses(env, (20, 20, 0), known=known)
    ring = known.copy()
    ring[16:25, 16:25] = False
    ring[25] = False
    set_cells(belief.map, np.flatnonzero(ring), 0.99)  # closed but for the side at x = 25
    policy = coopmap_baselines.make("projection", search="exhaustive")
    pose, _ = belief.actions.decode("robot_0", policy.act(belief, {})["robot_0"], belief)
    assert pose % 16 in (14, 15, 0, 1, 2)


def test_without_frontiers_nothing_is_gained():
    env = env_with_world(open_world(), n_robots=1)
    belief = set_poses(env, (20, 20, 0), known=np.ones((40, 40), dtype=bool))
    policy = coopmap_baselines.make("projection", search=20)
    assert not policy.gain(belief, 0, belief.feasible_poses(0)[:5], None).any()


def test_a_camera_that_sees_all_around_has_no_image():
    settings = PlanarSettings(camera=PlanarCamera(2 * math.pi, 6.0, 70))
    env = env_with_world(open_world(), n_robots=1, settings=settings)
    with pytest.raises(ValueError, match=r"field_of_view must be < pi .* got 6\.28.*: choose"):
        coopmap_baselines.make("projection").act(env.belief(), {})
