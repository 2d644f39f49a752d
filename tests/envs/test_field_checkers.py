"""The checkers that users' libraries bring, over modes, teams and mounts of the field."""

import gymnasium
import pettingzoo
import pytest
from gymnasium.utils.env_checker import check_env
from plain.rollouts import MODES

from coopmap_env import field_v1
from coopmap_env.envs.field import FieldEnv, FieldSettings

pytest.importorskip("pybullet")
# importing pettingzoo.test imports a board game of theirs that warns about its own old name
pytestmark = pytest.mark.filterwarnings(
    "ignore:The old environment creation API has been deprecated:DeprecationWarning"
)
NAME = "coopmap/Field-v1"
SEARCH = "coopmap/FieldSearch-v1"


@pytest.fixture(params=MODES)
def mode(request):
    return request.param


@pytest.fixture(params=[1, 3])
def arguments(request, mode):
    settings = FieldSettings(crop_cells=(8, 4))
    return {
        "n_robots": request.param,
        "action_mode": mode,
        "max_scans": 2,
        "n_candidates": 4,
        "settings": settings,
    }


def test_the_page_names_the_ids():
    assert field_v1.__doc__.count(NAME) == 1
    assert field_v1.__doc__.count(SEARCH) == 1


@pytest.mark.parametrize("name", [NAME, SEARCH])
def test_pettingzoo_accepts_the_parallel_environment(name, arguments, capsys):
    from pettingzoo.test import parallel_api_test, parallel_seed_test

    def make():
        return pettingzoo.make("parallel", name, **arguments)

    assert isinstance(make(), FieldEnv)
    parallel_api_test(make(), num_cycles=3)
    parallel_seed_test(make, num_cycles=2)
    assert "Passed" in capsys.readouterr().out


@pytest.mark.parametrize("name", [NAME, SEARCH])
def test_gymnasium_accepts_the_team_environment(name, arguments):
    env = gymnasium.make(name, **arguments)
    check_env(env.unwrapped, skip_render_check=True)
    env.reset(seed=0)
    env.step(env.action_space.sample())  # gymnasium.make's own checks
    env.close()


# Tables are neither image nor vector: the default feature extractor flattens them, as the checker
# advises. The crop of the map has more layers than a picture has colours.
@pytest.mark.filterwarnings("ignore:Your observation:UserWarning")
@pytest.mark.filterwarnings("ignore:The minimal resolution for an image:UserWarning")
@pytest.mark.filterwarnings("ignore:Treating image space as channels-last:UserWarning")
@pytest.mark.parametrize("initialization", ["located", "search"])
def test_stable_baselines_accepts_the_team_environment(initialization, arguments):
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    env = field_v1.team_env(initialization=initialization, **arguments)
    checker.check_env(env)
    env.close()


def test_a_team_of_different_mounts_acts_as_one():
    env = field_v1.team_env(
        n_robots=2, mount=["mast", "tiago"], max_scans=2, settings=FieldSettings(crop_cells=(8, 4))
    )
    assert env.action_space.shape == (5 + 3,)
    env.reset(seed=0)
    observation, *_ = env.step(env.action_space.sample())
    assert observation["joints"].shape == (8,)
    env.close()
