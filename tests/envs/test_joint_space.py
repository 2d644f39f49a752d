import math

import numpy as np
import pytest

from coopmap_env.envs.field._joint_space import JointSpace


def space(max_grid_poses=100):
    return JointSpace(np.array([-1.0, 0.0]), np.array([1.0, 4.0]), max_grid_poses)


def test_zero_is_the_middle_and_one_the_upper_limit_of_every_joint():
    np.testing.assert_allclose(space().denormalize([0.0, 0.0]), [0.0, 2.0])
    np.testing.assert_allclose(space().denormalize([1.0, 1.0]), [1.0, 4.0])
    np.testing.assert_allclose(space().denormalize([-0.5, -1.0]), [-0.5, 0.0])
    np.testing.assert_allclose(space().normalize([0.5, 3.0]), [0.5, 0.5])


def test_joints_beyond_their_limits_are_clipped_in_actions():
    np.testing.assert_array_equal(space().normalize([1.2, -0.1]), np.float32([1.0, -1.0]))


def test_a_joint_without_limits_turns_once_around():
    turning = JointSpace(np.array([-np.inf]), np.array([np.inf]), 10)
    np.testing.assert_allclose(turning.denormalize([[1.0], [-0.5]]), [[math.pi], [-math.pi / 2]])


def test_drawn_poses_and_the_grid_come_back_bit_for_bit_through_an_action():
    limits = JointSpace(np.array([-2.9, -0.3, 0.1]), np.array([2.9, 1.7, 0.45]), 4000)
    for poses in (limits.sample(5000, np.random.default_rng(0)), limits.grid()):
        actions = limits.normalize(poses)
        assert actions.dtype == np.float32
        np.testing.assert_array_equal(limits.denormalize(actions), poses)
        assert (poses >= limits.lower - 1e-12).all()
        assert (poses <= limits.upper + 1e-12).all()


def test_draws_are_uniform_over_each_joint():
    poses = space().sample(20_000, np.random.default_rng(1))
    np.testing.assert_allclose(poses.mean(axis=0), [0.0, 2.0], atol=0.03)
    np.testing.assert_allclose(poses.std(axis=0), [2 / math.sqrt(12), 4 / math.sqrt(12)], rtol=0.02)


@pytest.mark.parametrize(("size", "steps"), [(100, 10), (99, 9), (1, 1), (3, 1), (4, 2)])
def test_the_grid_holds_at_most_the_given_number_of_poses(size, steps):
    assert space(size).grid_steps == steps
    assert len(space(size).grid()) == steps**2 <= size


def test_the_grid_counts_the_last_joint_fastest_from_the_middles_of_equal_parts():
    np.testing.assert_allclose(
        space(4).grid(), [[-0.5, 1.0], [-0.5, 3.0], [0.5, 1.0], [0.5, 3.0]], atol=1e-6
    )


def test_grid_indices_follow_the_order_of_the_grid_and_include_the_limits():
    np.testing.assert_array_equal(space().grid_index(space().grid()), np.arange(100))
    np.testing.assert_array_equal(space().grid_index([[-1.0, 0.0], [1.0, 4.0]]), [0, 99])


@pytest.mark.parametrize("q", [0.5, [0.5], [0.1, 0.2, 0.3], [[0.1], [0.2]]])
def test_another_number_of_joints_is_refused(q):
    with pytest.raises(ValueError, match=r"joints must be \(\.\.\., 2\)"):
        space().normalize(q)
