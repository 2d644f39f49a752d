import numpy as np
import pytest
from plain.small_worlds import masked_world, small_world
from plain.toy_team import ConstantReward
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import VecCheckNan, VecMonitor
from vec_envs import shared

from coopmap_agents.sb3 import SharedPolicyVecEnv
from coopmap_env.vector import WorkerVectorEnv


def toy(n_envs=3, **arguments):
    return shared(lambda: ConstantReward(**arguments), n_envs)


def reset(env, seed):
    env.seed(seed)
    return env.reset()


def random_actions(env, rng):
    return rng.uniform(-1, 1, (env.num_envs, *env.action_space.shape)).astype(np.float32)


def assert_same(a, b):
    assert a.keys() == b.keys()
    for key in a:
        np.testing.assert_array_equal(a[key], b[key], err_msg=key)


def row_of(observations, row):
    return {key: values[row] for key, values in observations.items()}


def test_rows_are_the_robots_of_the_first_environment_then_those_of_the_next():
    env = toy(n_envs=3, n_robots=2)
    observations = reset(env, 0)
    assert env.num_envs == 6
    assert observations["pose"].shape == (6, 3)
    np.testing.assert_array_equal(observations["pose"][:, 0], [0, 1, 0, 1, 0, 1])
    episodes = observations["pose"][:, 2]
    np.testing.assert_array_equal(episodes[::2], episodes[1::2])
    assert len(set(episodes)) == 3


def test_each_robot_gets_the_action_of_its_row():
    env = toy(n_envs=2, n_robots=2)
    reset(env, 0)
    env.step(np.array([[0.1], [0.2], [0.3], [0.4]]))
    assert [dict(calls[-1]) for calls in env.get_attr("calls", indices=[0, 2])] == [
        {"robot_0": 0.1, "robot_1": 0.2},
        {"robot_0": 0.3, "robot_1": 0.4},
    ]


@pytest.mark.parametrize("n_robots", [1, 3])
def test_rows_are_what_stepping_the_environments_by_hand_gives_across_resets(n_robots):
    env = shared(lambda: small_world(n_robots=n_robots), 2)
    rng = np.random.default_rng(1)
    seeds = env.seed(5)
    observations = env.reset()
    by_hand = [small_world(n_robots=n_robots) for _ in range(2)]
    expected = [e.reset(seed=s)[0] for e, s in zip(by_hand, seeds[::n_robots], strict=True)]
    for step in range(1, 10):
        actions = random_actions(env, rng)
        observations, rewards, dones, infos = env.step(actions)
        assert dones.all() == (step % 4 == 0)
        for i, hand in enumerate(by_hand):
            rows = range(i * n_robots, (i + 1) * n_robots)
            given = {agent: actions[row] for agent, row in zip(hand.agents, rows, strict=True)}
            names = list(hand.agents)
            last, own_rewards, _, truncated, env_infos = hand.step(given)
            expected[i] = last if hand.agents else hand.reset()[0]
            for agent, row in zip(names, rows, strict=True):
                assert_same(row_of(observations, row), expected[i][agent])
                assert rewards[row] == np.float32(own_rewards[agent])
                own = env_infos[agent]
                assert own == {key: infos[row][key] for key in own}
                assert infos[row]["TimeLimit.truncated"] == truncated[agent] == dones[row]
                assert ("terminal_observation" in infos[row]) == dones[row]
                if dones[row]:
                    assert_same(infos[row]["terminal_observation"], last[agent])


def test_the_terminal_observation_is_the_last_and_the_returned_one_the_first_of_the_next():
    env = toy(n_envs=2, n_steps=2)
    first = reset(env, 0)["pose"]
    env.step(np.zeros((4, 1)))
    observations, _, dones, infos = env.step(np.zeros((4, 1)))
    assert dones.all()
    last = np.array([info["terminal_observation"]["pose"] for info in infos])
    np.testing.assert_array_equal(last[:, 1], 1.0)
    np.testing.assert_array_equal(last[:, 2], first[:, 2])
    np.testing.assert_array_equal(observations["pose"][:, 1], 0.0)
    assert not np.isin(observations["pose"][:, 2], first[:, 2]).any()
    env_infos = [info["episode_number"] for info in env.reset_infos]
    np.testing.assert_allclose(observations["pose"][:, 2], env_infos, rtol=1e-6)  # float32


def test_a_termination_is_done_but_not_truncated():
    env = toy(n_steps=1, truncates=False)
    reset(env, 0)
    _, _, dones, infos = env.step(np.zeros((6, 1)))
    assert dones.all()
    assert not any(info["TimeLimit.truncated"] for info in infos)
    assert all("terminal_observation" in info for info in infos)


def test_actions_are_used_once():
    env = toy()
    env.reset()
    env.step(np.zeros((6, 1)))
    with pytest.raises(RuntimeError, match=r"call step_async\(\)"):
        env.step_wait()


def test_observations_do_not_change_after_later_steps():
    env = toy()
    first = reset(env, 0)
    kept = first["pose"].copy()
    for _ in range(7):
        env.step(np.zeros((6, 1)))
    np.testing.assert_array_equal(first["pose"], kept)


def test_the_same_seed_gives_the_same_worlds_episode_after_episode():
    one, two = (shared(small_world, 2) for _ in range(2))
    assert_same(reset(one, 3), reset(two, 3))
    rng = np.random.default_rng(0)
    for _ in range(9):
        actions = random_actions(one, rng)
        a, b = one.step(actions), two.step(actions)
        assert_same(a[0], b[0])
        np.testing.assert_array_equal(a[1], b[1])


def test_another_seed_gives_other_worlds_and_so_does_the_next_environment():
    env = shared(small_world, 2)
    one, two = reset(env, 0), reset(env, 1)
    assert (one["pose"] != two["pose"]).any(axis=1).all()
    assert (one["pose"][:2] != one["pose"][2:]).any(axis=1).all()


def test_neighbouring_seeds_share_no_world():
    env = toy(n_envs=16)
    assert not set(env.seed(0)) & set(env.seed(1))


def test_robots_of_an_environment_share_its_seed_and_others_have_their_own():
    seeds = toy(n_envs=3, n_robots=2).seed(7)
    assert seeds[::2] == seeds[1::2]
    assert len(set(seeds)) == 3


def test_seeds_are_used_once_and_without_one_it_is_random():
    env = toy()
    first = reset(env, 0)["pose"]
    assert (env.reset()["pose"][:, 2] != first[:, 2]).all()
    assert env.seed() != env.seed()


def test_options_reach_each_environment_once():
    env = toy(n_envs=2)
    env.set_options({"k": 1})
    env.reset()
    env.reset()
    assert env.get_attr("options", indices=[0, 2]) == [[{"k": 1}, None]] * 2


def test_action_masks_are_those_of_the_observations():
    env = shared(masked_world, 2)
    observations = reset(env, 0)
    masks = env.action_masks()
    assert masks.shape == (4, 300)
    assert masks.dtype == bool
    np.testing.assert_array_equal(masks, observations["action_mask"] == 1)
    assert masks.any(axis=1).all()
    assert not masks.all()
    observations, *_ = env.step(np.zeros(4, dtype=np.int64))
    np.testing.assert_array_equal(env.action_masks(), observations["action_mask"] == 1)


def test_masks_are_found_by_the_maskable_ppo_of_sb3_contrib():
    env = VecMonitor(shared(masked_world, 2))
    assert env.has_attr("action_masks")
    env.reset()
    masks = np.stack(env.env_method("action_masks"))
    np.testing.assert_array_equal(masks, env.venv.action_masks())
    np.testing.assert_array_equal(env.env_method("action_masks", indices=[3, 0]), masks[[3, 0]])
    np.testing.assert_array_equal(env.get_attr("action_masks")[2](), masks)


def test_without_masks_there_is_no_such_attribute():
    env = toy()
    assert not env.has_attr("action_masks")
    with pytest.raises(AttributeError, match="not masked"):
        env.action_masks()
    with pytest.raises(RuntimeError, match="reset"):
        shared(masked_world, 1).action_masks()


def test_attributes_are_read_and_set_by_row():
    env = toy(n_envs=2, n_robots=2)
    env.set_attr("n_steps", 9, indices=[2, 3])
    assert env.get_attr("n_steps") == [5, 5, 9, 9]
    assert env.get_attr("n_steps", indices=3) == [9]
    assert env.has_attr("n_steps")
    assert not env.has_attr("no_such_thing")


def test_a_method_is_called_once_for_each_environment():
    env = toy(n_envs=2, n_robots=2)
    images = env.env_method("render", indices=[3, 0, 1])
    assert len(images) == 3
    assert env.get_attr("calls", indices=[0, 2]) == [["render"], ["render"]]
    assert images[1] is images[2]
    assert images[0] is not images[1]


def test_gymnasium_wrappers_are_never_found():
    assert toy(n_envs=1).env_is_wrapped(Monitor) == [False, False]


def test_an_image_shows_each_environment_once():
    env = toy(n_envs=4, n_robots=3, render_mode="rgb_array")
    assert env.render_mode == "rgb_array"
    assert env.render().shape == (2 * 4, 2 * 6, 3)


def test_close_closes_every_environment_once():
    env = toy(n_envs=3)
    calls = env.get_attr("calls")[::2]
    env.close()
    env.close()
    assert calls == [["close"]] * 3
    with pytest.raises(RuntimeError, match="closed"):
        env.reset()


def test_vec_monitor_counts_each_robot_s_own_episode():
    env = VecMonitor(toy(n_steps=3))
    env.seed(0)
    env.reset()
    for _ in range(3):
        _, _, _, infos = env.step(np.zeros((6, 1)))
    assert [(info["episode"]["r"], info["episode"]["l"]) for info in infos] == [(3.0, 3)] * 6


def test_observations_and_rewards_are_finite_and_in_their_space():
    inner = shared(small_world, 2)
    env = VecCheckNan(inner, raise_exception=True)
    env.seed(0)
    observations = env.reset()
    rng = np.random.default_rng(0)
    for _ in range(6):
        for row in range(env.num_envs):
            assert env.observation_space.contains(row_of(observations, row))
        observations, rewards, dones, infos = env.step(random_actions(env, rng))
        assert rewards.dtype == np.float32
        assert dones.dtype == bool
        assert len(infos) == env.num_envs


@pytest.mark.parametrize(
    "arguments", [{"rows": "teams", "autoreset_mode": "SameStep"}, {"autoreset_mode": "NextStep"}]
)
def test_another_kind_of_vector_environment_is_refused(arguments):
    with pytest.raises(ValueError, match=r'needs rows="agents" and autoreset_mode="SameStep"'):
        SharedPolicyVecEnv(WorkerVectorEnv(ConstantReward, 1, **arguments))


def test_options_that_differ_are_refused():
    env = toy(n_envs=2)
    env.set_options([{"k": row} for row in range(4)])
    with pytest.raises(ValueError, match="share their options"):
        env.reset()
