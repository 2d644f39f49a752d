"""What is left of an episode, as robots and central critics observe it."""

import numpy as np
import pytest
from plain.rollouts import random_actions
from plain.small_worlds import SETTINGS, small_world

from coopmap_env import field_v1, planar_v1
from coopmap_env.envs.budget import budget_fractions
from coopmap_env.simulation.scenes.planar import Obstacles


def observed(observations):
    """The entry of all robots, who share it."""
    first, *others = (observation["budget"] for observation in observations.values())
    for other in others:
        np.testing.assert_array_equal(first, other)
    assert first.dtype == np.float32
    return first.tolist()


def test_it_is_the_fractions_of_the_scans_and_of_the_time_that_are_left():
    assert budget_fractions(1, 9.0, 4, None).tolist() == [0.75, 1.0]
    assert budget_fractions(4, 9.0, 4, 12.0).tolist() == [0.0, 0.25]
    assert budget_fractions(2, 13.0, 4, 12.0).tolist() == [0.5, 0.0]
    many = budget_fractions(np.array([0, 3]), np.array([0.0, 6.0]), 4, 8.0)
    assert many.dtype == np.float32
    assert many.tolist() == [[1.0, 1.0], [0.25, 0.25]]


def test_robots_and_the_state_have_it_at_every_step():
    env = small_world(max_scans=4, max_time=8.0)  # scans take 2 s
    observations, _ = env.reset(seed=3)
    left = [observed(observations)]
    while env.agents:
        belief = env.belief()
        stay = {
            agent: belief.action_for(robot, belief.pose_ids[robot])
            for robot, agent in enumerate(belief.agents)
        }
        observations, *_ = env.step(stay)
        left.append(observed(observations))
        assert env.state()[-2:].tolist() == left[-1]
        belief = env.belief()
        assert left[-1] == [belief.budget.scans / 4, belief.budget.time / 8]
    assert left == [[1.0, 1.0], [0.75, 0.75], [0.5, 0.5], [0.25, 0.25], [0.0, 0.0]]


def test_time_is_all_there_where_it_does_not_end_the_episode():
    env = small_world(max_scans=2)
    observations, _ = env.reset(seed=0)
    left = [observed(observations)]
    while env.agents:
        observations, *_ = env.step(random_actions(env, np.random.default_rng(0)))
        left.append(observed(observations))
    assert left == [[1.0, 1.0], [0.5, 1.0], [0.0, 1.0]]


@pytest.mark.parametrize("rows", ["agents", "teams"])
def test_worlds_in_arrays_have_it_too(rows):
    arguments = {
        "scene": Obstacles(shape=(24, 24), side_min=2.0, side_max=6.0),
        "settings": SETTINGS,
        "max_scans": 3,
        "max_time": 9.0,
    }
    env = planar_v1.vector_env(
        2, rows=rows, autoreset_mode="SameStep", with_state=True, **arguments
    )
    single = planar_v1.parallel_env(**arguments)
    observations, _ = env.reset(seed=[4, 5])
    expected, _ = single.reset(seed=4)
    rng = np.random.default_rng(0)
    while single.agents:
        first = observations["budget"].reshape(2, 2, 2)[0]
        np.testing.assert_array_equal(first, [own["budget"] for own in expected.values()])
        np.testing.assert_array_equal(observations["state"].reshape(2, -1)[0, -2:], first[0])
        actions = random_actions(single, rng)
        both = np.tile(np.concatenate(list(actions.values())), 2)
        observations, _, _, ends, infos = env.step(both.reshape(env.action_space.shape))
        expected, *_ = single.step(actions)
    assert ends[0]
    np.testing.assert_array_equal(
        infos["final_obs"][0]["budget"][:2], expected["robot_0"]["budget"]
    )
    assert expected["robot_0"]["budget"].min() == 0.0
    np.testing.assert_array_equal(observations["budget"][0], 1.0)
    env.close()


def test_field_robots_have_it():
    pytest.importorskip("pybullet")
    pytest.importorskip("embreex")
    settings = field_v1.FieldSettings(crop_cells=(8, 4))
    env = field_v1.parallel_env(max_scans=2, max_time=100.0, settings=settings)
    observations, _ = env.reset(seed=0)
    assert observed(observations) == [1.0, 1.0]
    assert env.observation_space("robot_0").contains(observations["robot_0"])
    observations, *_, infos = env.step(random_actions(env, np.random.default_rng(0)))
    seconds = infos["robot_0"]["elapsed_time"]
    assert observed(observations) == [0.5, np.float32((100.0 - seconds) / 100.0)]
    assert env.state()[-2:].tolist() == observed(observations)
    assert env.state_space.contains(env.state())
    env.close()
