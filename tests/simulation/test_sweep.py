"""The quick check of a motion: what it does not mark is free, and it does not mark everything."""

import numpy as np
import pytest
from plain.field_worlds import base_pose
from plain.sweeps import collides_with_boxes, points_in_boxes

from coopmap_env.geometry import NO_SPHERES, Spheres
from coopmap_env.robots import make_mount
from coopmap_env.simulation.physics._joint_map import JointMap
from coopmap_env.simulation.physics._sweep import SweepObstacles, squared_distance_to_box
from coopmap_env.simulation.physics._sweep_model import SweepModel, covering_spheres

pytest.importorskip("pybullet")
NO_BOXES = np.zeros((0, 2, 3))


@pytest.fixture(scope="module")
def mast():
    return make_mount("mast")


@pytest.fixture(scope="module")
def sweep_model(mast):
    return JointMap.from_mount(mast).sweep_model


def arm_boxes():
    return {
        "post": np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.35]]),
        "upper_arm": np.array([[-0.045, -0.045, -0.03], [0.045, 0.045, 0.63]]),
        "forearm": np.array([[-0.035, -0.035, 0.0], [0.035, 0.035, 0.58]]),
        "head": np.array([[-0.03, -0.07, -0.035], [0.09, 0.07, 0.035]]),
    }


def test_distance_of_a_point_and_a_box_by_hand():
    lower, upper = np.zeros(3), np.array([1.0, 2.0, 3.0])
    assert squared_distance_to_box(0.5, 0.5, 0.5, lower, upper) == 0.0
    assert squared_distance_to_box(4.0, 1.0, 1.0, lower, upper) == 9.0
    assert squared_distance_to_box(-1.0, 4.0, 5.0, lower, upper) == 1.0 + 4.0 + 4.0


def test_spheres_in_a_row_cover_their_box():
    rng = np.random.default_rng(0)
    for size in ([0.1, 0.1, 0.66], [0.3, 0.3, 0.3], [2.0, 0.01, 0.3], [0.5, 0.0, 0.0]):
        box = np.array([[0.2, -0.1, 0.4], np.array([0.2, -0.1, 0.4]) + size])
        centers, radius = covering_spheres(box)
        points = rng.uniform(box[0], box[1], (2000, 3))
        apart = np.linalg.norm(points[:, None] - centers, axis=-1).min(axis=1)
        assert apart.max() <= radius + 1e-12


def test_what_is_not_marked_touches_nothing(mast, sweep_model):
    """Links sampled on a lattice, motions in thirty times as many configurations."""
    chain = mast.chain(with_suspension=True)
    where = base_pose(0.4, -0.2, 0.9)
    of, points = points_in_boxes(chain, arm_boxes(), list(arm_boxes()))
    rng = np.random.default_rng(1)
    n_marked = n_touching = n_stretches = 0
    for _ in range(12):
        lower = rng.uniform([-1.6, -1.6, 0.3], [1.6, 1.6, 2.2], (12, 3))
        boxes = np.stack([lower, lower + rng.uniform(0.02, 0.4, (12, 3))], axis=1)
        start, end = rng.uniform(chain.lower[3:], chain.upper[3:], (2, 5))
        k = int(np.ceil(np.abs(end - start).max() / 0.15)) + 1
        q = np.zeros((k, 8))
        q[:, 3:] = start + np.linspace(0, 1, k)[:, None] * (end - start)
        marked, moved = sweep_model.swept_collisions(
            where.arrays, q, SweepObstacles(boxes, NO_SPHERES)
        )
        for a, b, mark, far in zip(q[:-1], q[1:], marked, moved, strict=True):
            fine = a + np.linspace(0, 1, 30)[:, None] * (b - a)
            at = where.transform(chain.point_positions(fine, of, points))
            touching = collides_with_boxes(at, boxes).any()
            assert mark or not touching
            assert far < 0.6
            n_marked, n_touching = n_marked + mark, n_touching + touching
            n_stretches += 1
    assert n_touching > 20
    assert n_marked < 0.8 * n_stretches


def test_another_vehicles_spheres_are_obstacles(sweep_model):
    here, beside = base_pose(0.0, 0.0), base_pose(1.2, 0.0, np.pi)
    q = np.zeros((2, 8))
    q[:, 4], q[:, 5] = 0.7, [0.2, 0.3]
    others = sweep_model.spheres(beside.arrays, q[0])
    assert sweep_model.swept_collisions(here.arrays, q, SweepObstacles(NO_BOXES, others))[0].all()
    far = Spheres(others.centers + np.array([5.0, 0.0, 0.0]), others.radii)
    assert not sweep_model.swept_collisions(here.arrays, q, SweepObstacles(NO_BOXES, far))[0].any()


def test_an_arm_that_comes_near_its_own_body_is_marked(sweep_model):
    """Bent down further than it can, the wrist is beside the chassis; upright it is far from it."""
    here, nothing = base_pose(0.0, 0.0), SweepObstacles(NO_BOXES, NO_SPHERES)
    down, up = np.zeros((2, 8)), np.zeros((2, 8))
    down[:, 4], down[:, 5] = 1.0, [2.1, 2.2]
    up[:, 5] = [0.2, 0.3]
    assert sweep_model.swept_collisions(here.arrays, down, nothing)[0].all()
    assert not sweep_model.swept_collisions(here.arrays, up, nothing)[0].any()


def test_adjacent_links_are_no_obstacle(mast):
    """The post stands on the chassis for good."""
    chain = mast.chain(with_suspension=True)
    boxes = {
        "chassis": np.array([[-0.45, -0.3, -0.05], [0.45, 0.3, 0.35]]),
        "post": np.array([[-0.1, -0.1, 0.0], [0.1, 0.1, 0.35]]),
    }
    q, where = np.zeros((2, 8)), base_pose(0.0, 0.0)
    nothing = SweepObstacles(NO_BOXES, NO_SPHERES)
    for ignored_pairs, expected in (([("post", "chassis")], False), ([], True)):
        model = SweepModel.from_link_boxes(chain, boxes, ["post"], ignored_pairs)
        marked, _ = model.swept_collisions(where.arrays, q, nothing)
        assert marked.tolist() == [expected]
