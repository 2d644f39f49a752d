import re
from functools import cache

import numpy as np
import pytest
from plain.rollouts import MODES, env_trajectory_hash, random_actions, trajectory_hash

from coopmap_env.envs import InvalidActionError
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.envs.planar import PlanarTeamEnv as TeamEnv
from coopmap_env.simulation.scenes.planar import Obstacles

NAN, INF = float("nan"), float("inf")
FINE = np.zeros(3, dtype=np.float32)

WRONG_POSES = [
    ([0.0, NAN, 0.0], r"robot_1: .* \[-1, 1\], got \[0.0, nan, 0.0\]"),
    ([INF, 0.0, 0.0], r"robot_1: .* \[-1, 1\], got \[inf, 0.0, 0.0\]"),
    ([0.0, 0.0, -INF], r"robot_1: .* \[-1, 1\], got \[0.0, 0.0, -inf\]"),
    ([0.0, 1.001, 0.0], r"robot_1: .* \[-1, 1\], got \[0.0, 1.001, 0.0\]"),
    ([0.0, 0.0, -2], r"robot_1: .* \[-1, 1\], got \[0.0, 0.0, -2\]"),
    ([0.0, 0.0], r"robot_1: .* 3 numbers .* got \[0.0, 0.0\]"),
    ([0.0] * 4, r"robot_1: .* 3 numbers .* got \[0.0, 0.0, 0.0, 0.0\]"),
    (np.zeros((1, 3)), r"robot_1: .* 3 numbers .* got array\(\[\[0., 0., 0.\]\]\)"),
    (np.zeros((3, 1)), r"robot_1: .* 3 numbers"),
    (0.5, r"robot_1: .* 3 numbers .* got 0.5"),
    (None, r"robot_1: .* 3 numbers .* got None"),
    ("far", r"robot_1: .* 3 numbers .* got 'far'"),
    ({"ahead": 1.0}, r"robot_1: .* 3 numbers .* got \{'ahead': 1.0\}"),
    ([[0.0], [0.0, 1.0], [0.0]], r"robot_1: .* 3 numbers"),
]
WRONG_CANDIDATES = [
    (1.0, r"robot_1: .* one integer, got 1.0"),
    (np.float32(1), r"robot_1: .* one integer, got "),
    (NAN, r"robot_1: .* one integer, got nan"),
    (True, r"robot_1: .* one integer, got True"),
    (None, r"robot_1: .* one integer, got None"),
    ("1", r"robot_1: .* one integer, got '1'"),
    ([1], r"robot_1: .* one integer, got \[1\]"),
    (10**30, r"robot_1: .* one integer, got 1000"),
    (8, r"robot_1: .* 0 ... 7, got 8"),
    (-1, r"robot_1: .* 0 ... 7, got -1"),
]


def small(mode):
    scene = Obstacles(shape=(48, 48))
    return {"action_mode": mode, "scene": scene, "max_scans": 3, "n_candidates": 8}


@cache
def expected_hash(mode):
    """Of the episode of seed 2 in which nobody does anything wrong."""
    return env_trajectory_hash(small(mode), 2)


def refused_steps(actions, message):
    """A wrong step to try before every right one."""

    def attempt(env):
        with pytest.raises(InvalidActionError, match=message):
            env.step(actions)

    return attempt


@pytest.mark.parametrize(("action", "message"), WRONG_POSES)
def test_a_wrong_pose_names_robot_and_value_and_changes_nothing(action, message):
    wrong = refused_steps({"robot_0": FINE, "robot_1": action}, message)
    assert trajectory_hash(PlanarEnv(**small("pose")), 2, wrong) == expected_hash("pose")


@pytest.mark.parametrize(("action", "message"), WRONG_CANDIDATES)
def test_a_wrong_candidate_names_robot_and_value_and_changes_nothing(action, message):
    wrong = refused_steps({"robot_0": 0, "robot_1": action}, message)
    env = PlanarEnv(**small("candidates"))
    assert trajectory_hash(env, 2, wrong) == expected_hash("candidates")


@pytest.mark.parametrize(
    ("actions", "message"),
    [
        ({"robot_0": FINE}, r"\['robot_0', 'robot_1'\] is needed, got \['robot_0'\]"),
        ({}, r"needed, got \[\]"),
        (
            {"robot_0": FINE, "robot_1": FINE, "robot_2": FINE},
            r"needed, got \['robot_0', 'robot_1', 'robot_2'\]",
        ),
        ({"robot_0": FINE, "robot_7": FINE}, r"needed, got \['robot_0', 'robot_7'\]"),
        ({0: FINE, 1: FINE}, r"needed, got \['0', '1'\]"),
        ([FINE, FINE], r"needed, got '?\[array"),
        (None, r"needed, got '?None"),
    ],
)
def test_a_missing_or_superfluous_robot_is_named_and_changes_nothing(actions, message):
    wrong = refused_steps(actions, message)
    assert trajectory_hash(PlanarEnv(**small("pose")), 2, wrong) == expected_hash("pose")


@pytest.mark.parametrize("seed", [-1, 1.0, "1", True, NAN, [1], np.float64(2)])
@pytest.mark.parametrize("make", [PlanarEnv, TeamEnv])
def test_a_wrong_seed_is_named(make, seed):
    with pytest.raises(ValueError, match=re.escape(repr(seed))):
        make().reset(seed=seed)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("seed", [-1, 1.0])
def test_a_wrong_seed_leaves_the_running_episode_as_it_is(seed, mode):
    def wrong(env):
        with pytest.raises(ValueError, match="seed"):
            env.reset(seed=seed)

    assert trajectory_hash(PlanarEnv(**small(mode)), 2, wrong) == expected_hash(mode)


def test_a_numpy_integer_is_a_seed():
    for make in (PlanarEnv, TeamEnv):
        env, same = make(max_scans=1), make(max_scans=1)
        observation, _ = env.reset(seed=np.int64(3))
        expected, _ = same.reset(seed=3)
        assert repr(observation) == repr(expected)


def test_nothing_works_before_the_first_reset():
    env = PlanarEnv(render_mode="rgb_array")
    for call in (env.state, env.belief, env.render, lambda: env.truth, lambda: env.step({})):
        with pytest.raises(RuntimeError, match=r"reset\(\)"):
            call()
    env.close()


@pytest.mark.parametrize("mode", MODES)
def test_a_step_after_the_end_asks_for_a_reset_and_changes_nothing(mode):
    env, rng = PlanarEnv(**small(mode)), np.random.default_rng(0)
    env.reset(seed=2)
    while env.agents:
        actions = random_actions(env, rng)
        env.step(actions)
    before = env.state()
    for given in (actions, {}):
        with pytest.raises(RuntimeError, match=r"ended after 3 scans: call reset\(\)"):
            env.step(given)
    np.testing.assert_array_equal(env.state(), before)
    assert trajectory_hash(env, 2) == expected_hash(mode)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("n_robots", value) for value in (0, -1, 1.5, "2", None, True)),
        *(("max_scans", value) for value in (0, -1, 2.0, NAN, None)),
        *(("n_candidates", value) for value in (0, -1, 32.0, None)),
        *(("action_mode", value) for value in ("poses", None, 3)),
        *(("reward", value) for value in ("ratings", None, "refused")),
        *(("team_reward", value) for value in ("mean", None)),
        *(("scene", value) for value in ("office", None, 7, Obstacles)),
        *(("split", value) for value in ("dev", None, 0)),
        *(("settings", value) for value in ({}, {"reach": 3.0}, 5, PlanarSettings)),
        *(("render_mode", value) for value in ("ansi", False, 1)),
    ],
)
@pytest.mark.parametrize("make", [PlanarEnv, TeamEnv])
def test_a_wrong_argument_is_named_with_its_value(make, name, value):
    with pytest.raises(ValueError, match=f"(?s){name}.*{re.escape(repr(value))}"):
        make(**{name: value})


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("reach", value) for value in (0.0, -1.0, NAN, INF)),
        *(("initial_free_radius", value) for value in (0.0, NAN, INF)),
        *(("max_start_distance", value) for value in (-1.0, NAN, INF)),
        *(("crop_cells", value) for value in (3, -1, 0, 10.5)),
    ],
)
def test_a_wrong_setting_is_named_with_its_value(name, value):
    with pytest.raises(ValueError, match=f"PlanarSettings.{name} .*{re.escape(str(value))}"):
        PlanarSettings(**{name: value})


def test_the_number_of_headings_is_checked():
    with pytest.raises(ValueError, match="n_headings must be an integer >= 1, got 0"):
        PlanarEnv(settings=PlanarSettings(n_headings=0))


class Fickle(Obstacles):
    """A scene whose second world is not what it said."""

    made = 0

    def world(self, rng):
        Fickle.made += 1
        scene = Obstacles() if Fickle.made % 2 else Obstacles(shape=(150, 200))
        return scene.world(rng)


def test_a_scene_that_makes_another_shape_than_it_said_is_named_and_the_episode_goes_on():
    Fickle.made = 0
    env = PlanarEnv(scene=Fickle(), max_scans=4)

    def wrong(env):
        Fickle.made = 1
        with pytest.raises(ValueError, match=r"'obstacles' made .* shape \(150, 200\), not"):
            env.reset(seed=9)

    assert trajectory_hash(env, 2, wrong) == env_trajectory_hash({"max_scans": 4}, 2)


def test_the_team_environment_names_shape_and_robot():
    env = TeamEnv()
    env.reset(seed=0)
    with pytest.raises(InvalidActionError, match=r"shape \(6,\), got \(3,\)"):
        env.step(FINE)
    with pytest.raises(InvalidActionError, match=r"robot_1: .* nan"):
        env.step([0, 0, 0, 0, NAN, 0])
    candidates = TeamEnv(action_mode="candidates")
    candidates.reset(seed=0)
    with pytest.raises(InvalidActionError, match=r"shape \(2,\), got \(3,\)"):
        candidates.step([0, 0, 0])
    with pytest.raises(InvalidActionError, match=r"robot_0: .* one integer, got .*0\.5"):
        candidates.step([0.5, 1.0])
    with pytest.raises(InvalidActionError, match=r"robot_1: .* 0 \.\.\. 31, got 32"):
        candidates.step([0, 32])


def test_the_house_names_the_pip_command_where_its_data_are_missing(monkeypatch):
    import importlib

    real = importlib.import_module

    def without_data(name, package=None):
        if name == "rtbdata":
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)
        return real(name, package)

    monkeypatch.setattr(importlib, "import_module", without_data)
    with pytest.raises(ImportError, match=r"rtbdata .* pip install 'coopmap\[data\]'"):
        PlanarEnv(scene="house")
