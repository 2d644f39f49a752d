"""The checkers that users' libraries bring, over every registered id, mode, team and scene."""

import gymnasium
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from plain.rollouts import MODES

from coopmap_env import families, planar_v1
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.envs.planar import PlanarTeamEnv as TeamEnv

# importing pettingzoo.test imports a board game of theirs that warns about its own old name
pytestmark = pytest.mark.filterwarnings(
    "ignore:The old environment creation API has been deprecated:DeprecationWarning"
)

FAMILY_IDS = [family.env_id for family in families.FAMILIES.values()]
PLANAR_FAMILY_IDS = [name for name in FAMILY_IDS if name.startswith("coopmap/Planar")]


def test_the_documented_ids_are_in_both_registries():
    ids = ["coopmap/Planar-v1", "coopmap/Field-v1", "coopmap/FieldSearch-v1", *FAMILY_IDS]
    assert [name for name in gymnasium.registry if name.startswith("coopmap/")] == ids
    assert [name for name in pettingzoo.parallel_registry if name.startswith("coopmap/")] == ids
    assert planar_v1.__doc__.count(ids[0]) == 1


@pytest.fixture(params=MODES)
def mode(request):
    return request.param


@pytest.fixture(params=[1, 3])
def arguments(request, mode, scene):
    return {"n_robots": request.param, "action_mode": mode, "scene": scene, "max_scans": 3}


def test_pettingzoo_accepts_the_parallel_environment(arguments, capsys):
    check_parallel("coopmap/Planar-v1", arguments, capsys)


@pytest.mark.parametrize("name", PLANAR_FAMILY_IDS)
def test_pettingzoo_accepts_families(name, mode, capsys):
    check_parallel(name, {"action_mode": mode}, capsys)


def check_parallel(name, arguments, capsys):
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    def make():
        return pettingzoo.make("parallel", name, **arguments)

    assert isinstance(make(), PlanarEnv)
    parallel_api_test(make(), num_cycles=8)
    parallel_seed_test(make, num_cycles=4)
    assert "Passed" in capsys.readouterr().out


def test_gymnasium_accepts_the_team_environment(arguments):
    check_team("coopmap/Planar-v1", arguments)


@pytest.mark.parametrize("name", PLANAR_FAMILY_IDS)
def test_gymnasium_accepts_families(name, mode):
    check_team(name, {"action_mode": mode})


def check_team(name, arguments):
    env = gymnasium.make(name, **arguments)
    assert isinstance(env.unwrapped, TeamEnv)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    env.step(env.action_space.sample())  # gymnasium.make's own checks


def test_gymnasium_accepts_the_team_environment_with_its_pictures():
    pytest.importorskip("PIL")
    env = gymnasium.make("coopmap/Planar-v1", render_mode="rgb_array", max_scans=3)
    check_env(env.unwrapped)


# The candidate table (m, 9) and the teammates (n - 1, 4) are neither image nor vector. They are
# flattened by the default feature extractor, which is what the checker advises.
@pytest.mark.filterwarnings(
    "ignore:Your observation (candidates|teammates) has an unconventional shape:UserWarning"
)
def test_stable_baselines_accepts_the_team_environment(arguments):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    checker.check_env(planar_v1.team_env(**arguments))
