"""What PettingZoo and Gymnasium expect beside the parallel environments: turns, cycles, ids."""

import subprocess
import sys

import numpy as np
import pytest
from plain.rollouts import MODES
from plain.small_worlds import SETTINGS, small_world

from coopmap_env import field_v1, planar_v1

# importing pettingzoo.test imports a board game of theirs that warns about its own old name
pytestmark = pytest.mark.filterwarnings(
    "ignore:The old environment creation API has been deprecated:DeprecationWarning"
)


@pytest.fixture(params=[planar_v1, field_v1], ids=["planar", "field"])
def page(request):
    if request.param is field_v1:
        pytest.importorskip("pybullet")
    return request.param


@pytest.mark.filterwarnings("ignore:Observation:UserWarning")  # it would like arrays, not dicts
@pytest.mark.parametrize("mode", MODES)
def test_pettingzoo_accepts_the_environment_in_turns(page, mode, capsys):
    from pettingzoo.test import api_test, seed_test

    def make():
        return page.env(action_mode=mode, n_candidates=4, max_scans=2)

    api_test(make(), num_cycles=5)
    seed_test(make, num_cycles=2)
    assert "Passed" in capsys.readouterr().out


@pytest.mark.parametrize("mode", MODES)
def test_turns_play_the_episode_of_the_parallel_environment(mode):
    arguments = {"action_mode": mode, "settings": SETTINGS, "n_robots": 3, "max_scans": 3}
    turns, parallel = planar_v1.raw_env(**arguments), planar_v1.parallel_env(**arguments)
    turns.reset(seed=4)
    parallel.reset(seed=4)
    rng = np.random.default_rng(0)
    while parallel.agents:
        actions = {}
        for agent in parallel.possible_agents:
            assert turns.agent_selection == agent
            space = turns.action_space(agent)
            actions[agent] = rng.integers(space.n) if mode == "candidates" else rng.random(3)
            turns.step(actions[agent])
        _, rewards, _, truncations, infos = parallel.step(actions)
        for robot, agent in enumerate(parallel.possible_agents):
            assert turns.rewards[agent] == rewards[agent]
            assert turns.truncations[agent] == truncations[agent]
            assert turns.infos[agent] == infos[agent]
            assert turns.agents[robot] == agent
    np.testing.assert_array_equal(turns.state(), parallel.state())


def test_cycles_are_scans(page):
    from pettingzoo.test.max_cycles_test import max_cycles_test

    max_cycles_test(page)


def test_cycles_replace_scans_and_are_checked():
    assert small_world(max_scans=9, max_cycles=2).max_scans == 2
    assert small_world(max_scans=9).max_scans == 9
    with pytest.raises(ValueError, match="max_cycles"):
        small_world(max_cycles=0)


@pytest.mark.parametrize("name", ["coopmap/Planar-v1", "coopmap/Planar-crowded-v1"])
def test_gymnasium_makes_an_id_that_names_the_package_without_an_import(name):
    """Gymnasium has loaded no entry points of plugins since 1.0."""
    code = f"import gymnasium; print(gymnasium.make('coopmap_env:{name}').reset(seed=0)[1])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "observed_fraction" in done.stdout
