"""Views of planar worlds: they show the world as it is now, and cannot be stepped."""

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from plain.rollouts import MODES

from coopmap_env import planar_v1
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.envs.planar.worlds import step_worlds
from coopmap_env.mapping.pooling import PooledMap
from coopmap_env.simulation.scenes.planar import Obstacles

SMALL = Obstacles(shape=(40, 30), side_max=8.0)


def worlds(n=2, **arguments):
    return planar_v1.vector_env(n, scene=SMALL, max_scans=2, **arguments)


def stepped(env):
    env.action_space.seed(0)
    return env.step(env.action_space.sample())


def test_pictures_are_those_of_a_single_environment_without_its_trails():
    env, single = worlds(render_mode="rgb_array"), PlanarEnv(scene=SMALL, render_mode="rgb_array")
    env.reset(seed=3)
    single.reset(seed=4)
    pictures = env.render()
    assert [picture.dtype for picture in pictures] == [np.uint8, np.uint8]
    assert pictures[1].shape == single.render().shape
    assert (pictures[0] != pictures[1]).any()


def test_a_view_is_there_before_the_first_reset_and_follows_its_world():
    env = worlds()
    view = env.world(1)
    assert view.agents == []
    with pytest.raises(RuntimeError, match="call reset"):
        view.belief()
    env.reset(seed=0)
    assert view is env.world(1)
    assert view.agents == ["robot_0", "robot_1"]
    stepped(env)
    stepped(env)
    assert view.agents == []  # the next step resets the world


@pytest.mark.parametrize("mode", MODES)
def test_a_step_is_the_compiled_one_of_a_single_environment(mode):
    single = PlanarEnv(scene=SMALL, action_mode=mode, max_scans=2)
    single.reset(seed=0)
    single.step({agent: single.action_space(agent).sample() for agent in single.agents})
    compiled = set(step_worlds.signatures)
    env = worlds(action_mode=mode)
    env.reset(seed=0)
    stepped(env)
    assert set(step_worlds.signatures) == compiled


def test_what_is_set_on_a_view_stays_and_what_the_engine_goes_by_cannot_be_set():
    env = worlds()
    env.reset(seed=0)
    env.set_attr("planner", [1, 2])
    stepped(env)
    assert env.get_attr("planner") == (1, 2)
    with pytest.raises(AttributeError, match="max_scans"):
        env.set_attr("max_scans", 5)


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_a_view_cannot_be_copied(copied):
    with pytest.raises(TypeError, match="cannot be copied or pickled"):
        copied(worlds().world(0))


def test_planners_of_many_worlds_may_run_in_threads():
    env = planar_v1.vector_env(8, max_scans=4)
    env.reset(seed=0)
    stepped(env)

    def poses(world):
        belief = env.world(world).belief()
        return np.concatenate(
            [belief.random_poses(0, 300, np.random.default_rng(k)) for k in range(5)]
        )

    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(poses, range(8)))
    for world in range(8):
        np.testing.assert_array_equal(together[world], poses(world))


@pytest.mark.parametrize("single", [True, False])
def test_the_pooled_map_is_that_of_now(single):
    env = PlanarEnv(scene=SMALL) if single else worlds()

    def current_map():
        return (env if single else env.world(0)).belief().map

    env.reset(seed=0)
    before = current_map().pooled.sampled_mask.copy()
    env.step({a: np.zeros(3) for a in env.agents} if single else np.zeros((4, 3)))
    shown, expected = current_map().pooled, PooledMap(current_map().arrays).arrays
    assert (shown.sampled_mask != before).any()
    np.testing.assert_array_equal(shown.log_odds_fixed, expected.log_odds_fixed)
    np.testing.assert_array_equal(shown.sampled_mask, expected.sampled_mask)


def test_with_two_buffers_what_ended_worlds_showed_lasts_one_more_step():
    env = planar_v1.vector_env(
        2, scene=SMALL, max_scans=1, autoreset_mode="SameStep", double_buffer=True
    )
    env.reset(seed=0)
    infos = stepped(env)[-1]
    kept = [{key: own.copy() for key, own in row.items()} for row in infos["final_obs"]]
    stepped(env)
    np.testing.assert_equal(list(infos["final_obs"]), kept)


class FailsOnce(Obstacles):
    """A scene that fails when it is asked for the third time."""

    calls = 0

    def world(self, rng):
        type(self).calls += 1
        if self.calls == 3:
            raise OSError("no more worlds")
        return super().world(rng)


def test_a_scene_that_fails_changes_no_world():
    FailsOnce.calls = 0
    env = planar_v1.vector_env(2, scene=FailsOnce(shape=(40, 30), side_max=8.0))
    env.reset(seed=0)
    truth, poses = env.world(0).truth, env.world(0).belief().pose_ids
    with pytest.raises(OSError, match="no more worlds") as raised:
        env.reset(seed=7)
    assert raised.value.__notes__ == ["in world 0"]
    assert env.world(0).truth is truth
    assert env.world(0).belief().pose_ids == poses
    env.reset(seed=7)


def test_seeds_and_numbers_may_be_those_of_numpy():
    env = planar_v1.vector_env(np.int64(2), scene=SMALL, num_threads=np.int32(2))
    first, _ = env.reset(seed=np.array(5))
    shown = first["map"].copy()
    np.testing.assert_array_equal(env.reset(seed=[5, 6])[0]["map"], shown)


def test_more_poses_than_a_word_can_choose_among_are_refused():
    settings = replace(PlanarSettings(), reach=2000.0, n_headings=3600)
    with pytest.raises(ValueError, match=r"reach 2000.0 m with n_headings 3600 .* lower one"):
        PlanarEnv(scene=Obstacles(shape=(700, 700)), settings=settings)


def test_a_reach_beyond_all_bounds_is_the_whole_world():
    masks = []
    for reach in (1e3, 1e30):
        env = PlanarEnv(
            scene=SMALL, action_mode="candidates", settings=replace(PlanarSettings(), reach=reach)
        )
        observations, _ = env.reset(seed=0)
        masks.append([own["action_mask"].sum() for own in observations.values()])
    assert masks[0] == masks[1]
    assert min(masks[0]) > 0


def test_a_team_whose_scans_take_too_much_memory_is_refused():
    with pytest.raises(ValueError, match="all robots scan"):
        PlanarEnv(n_robots=1_000, scene=Obstacles(shape=(3_000, 3_000)))
