import gymnasium
import numpy as np
import pytest
from gymnasium import spaces
from plain.rollouts import MODES, random_rollout, sample_action

from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.envs.planar import PlanarTeamEnv as TeamEnv
from coopmap_env.information import PlanarRatingSettings

DTYPES = {
    "map": np.uint8,
    "pose": np.float32,
    "budget": np.float32,
    "teammates": np.float32,
    "candidates": np.float32,
    "action_mask": np.int8,
}


def assert_contained(space, observation):
    assert space.contains(observation)
    assert set(observation) == set(space.spaces)
    for key, value in observation.items():
        assert type(value) is np.ndarray
        assert value.dtype == DTYPES[key]
        assert value.dtype == space[key].dtype
        assert np.isfinite(value).all()


@pytest.mark.parametrize("n_robots", [1, 2, 3])
@pytest.mark.parametrize("mode", MODES)
def test_everything_observed_lies_in_its_space_at_every_step(mode, n_robots, scene):
    env = PlanarEnv(n_robots, mode, scene=scene, max_scans=8)
    for seed in range(2):
        for observations, *_, state in random_rollout(env, seed, np.random.default_rng(seed)):
            assert list(observations) == env.possible_agents
            for agent, observation in observations.items():
                assert_contained(env.observation_space(agent), observation)
            assert state.dtype == np.float32
            assert env.state_space.contains(state)


@pytest.mark.parametrize(
    "rating",
    [
        PlanarRatingSettings(n_gray_bins=2, K=0.0),
        PlanarRatingSettings(n_gray_bins=256, K=1e6, exponent=3.0),
        PlanarRatingSettings(alpha_position=0.0, alpha_heading=50.0),
    ],
)
def test_features_stay_in_their_space_whatever_the_constants(rating):
    settings = PlanarSettings(rating=rating, n_headings=5, crop_cells=7, reach=300.0)
    env = PlanarEnv(3, "candidates", settings=settings, max_scans=5)
    for observations, *_ in random_rollout(env, 0, np.random.default_rng(0)):
        for agent, observation in observations.items():
            assert_contained(env.observation_space(agent), observation)


@pytest.mark.parametrize("n_robots", [1, 3])
@pytest.mark.parametrize("mode", MODES)
def test_the_team_environment_keeps_to_its_spaces_too(mode, n_robots):
    env = TeamEnv(n_robots=n_robots, action_mode=mode, max_scans=5)
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    truncated = False
    while not truncated:
        assert_contained(env.observation_space, observation)
        if mode == "candidates":
            action = np.array([rng.integers(32) for _ in range(n_robots)])
        else:
            action = sample_action(env.action_space, rng)
        observation, reward, terminated, truncated, _ = env.step(action)
        assert type(reward) is float
        assert not terminated
    assert_contained(env.observation_space, observation)


@pytest.mark.parametrize("mode", MODES)
def test_spaces_are_the_same_objects_each_time(mode):
    env = PlanarEnv(action_mode=mode)
    before = [env.state_space]
    for agent in env.possible_agents:
        before += [env.observation_space(agent), env.action_space(agent)]
    env.reset(seed=0)
    after = [env.state_space]
    for agent in env.possible_agents:
        after += [env.observation_space(agent), env.action_space(agent)]
    assert [id(space) for space in before] == [id(space) for space in after]
    assert len({id(space) for space in before}) == len(
        before
    )  # robots share none: each has its rng


def test_spaces_are_those_of_the_page():
    settings = PlanarSettings(crop_cells=64)
    env = PlanarEnv(3, "candidates", n_candidates=10, settings=settings)
    space = env.observation_space("robot_1")
    assert isinstance(space, spaces.Dict)
    assert {key: part.shape for key, part in space.spaces.items()} == {
        "map": (4, 64, 64),
        "pose": (4,),
        "budget": (2,),
        "teammates": (2, 4),
        "candidates": (10, 9),
        "action_mask": (10,),
    }
    assert env.action_space("robot_1") == spaces.Discrete(10)
    assert env.state_space.shape == (2 * 200 * 200 + 4 * 3 + 2,)
    alone = PlanarEnv(1).observation_space("robot_0")
    assert set(alone.spaces) == {"map", "pose", "budget"}
    assert PlanarEnv(1).action_space("robot_0") == spaces.Box(-1, 1, (3,), np.float32)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("max_scans", [1, 2, 7])
def test_an_episode_is_truncated_after_exactly_max_scans_and_never_terminated(max_scans, mode):
    env = PlanarEnv(max_scans=max_scans, action_mode=mode, scene="rooms")
    for seed in range(2):
        episode = random_rollout(env, seed, np.random.default_rng(0))
        next(episode)
        assert env.agents == env.possible_agents
        for scan in range(1, max_scans + 1):
            _, _, terminations, truncations, infos, _ = next(episode)
            assert terminations == dict.fromkeys(env.possible_agents, False)
            assert truncations == dict.fromkeys(env.possible_agents, scan == max_scans)
            assert {info["n_scans"] for info in infos.values()} == {scan}
            assert env.agents == ([] if scan == max_scans else env.possible_agents)
        assert next(episode, None) is None


def test_the_team_environment_joins_its_robots_along_the_first_axis():
    arguments = {"n_robots": 3, "action_mode": "candidates", "max_scans": 4}
    team, robots = TeamEnv(**arguments), PlanarEnv(**arguments)
    joined, _ = team.reset(seed=3)
    each, _ = robots.reset(seed=3)
    rng = np.random.default_rng(0)
    while robots.agents:
        for key, value in joined.items():
            np.testing.assert_array_equal(value, np.concatenate([o[key] for o in each.values()]))
        action = rng.integers(32, size=3)
        actions = dict(zip(robots.agents, action, strict=True))
        joined, reward, _, truncated, info = team.step(action)
        each, rewards, _, truncations, infos = robots.step(actions)
        assert reward == sum(rewards.values())
        assert truncated == truncations["robot_0"]
        assert info.keys() == infos["robot_2"].keys()
        for key, values in info.items():
            assert values.tolist() == [own[key] for own in infos.values()]
    assert truncated


def test_gymnasium_makes_the_team_environment_with_its_arguments():
    env = gymnasium.make("coopmap/Planar-v1", n_robots=1, scene="rooms", max_scans=1)
    env.reset(seed=0)
    assert env.unwrapped.parallel.scene.name == "rooms"
    *_, truncated, _ = env.step(np.zeros(3, dtype=np.float32))
    assert truncated
