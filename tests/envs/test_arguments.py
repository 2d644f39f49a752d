import inspect
import re
from functools import partial
from typing import get_args, get_type_hints

import pytest

from coopmap_env import field_v1, planar_v1
from coopmap_env.envs.arguments import MappingArguments
from coopmap_env.envs.field import FieldArguments, FieldEnv
from coopmap_env.envs.planar import PlanarArguments, PlanarEnv, PlanarTeamEnv
from coopmap_env.envs.rewards import REWARD_TERMS
from coopmap_env.simulation.scenes import SPLITS


def test_choices_are_those_of_the_rewards_splits_and_pictures():
    hints = get_type_hints(MappingArguments)
    assert get_args(hints["reward"]) == tuple(REWARD_TERMS)
    assert get_args(hints["split"]) == SPLITS
    modes = list(get_args(get_args(hints["render_mode"])[0]))
    assert modes == PlanarEnv.metadata["render_modes"] == FieldEnv.metadata["render_modes"]


@pytest.mark.parametrize(
    ("constructor", "arguments"),
    [
        (planar_v1.parallel_env, PlanarArguments),
        (planar_v1.team_env, PlanarArguments),
        (field_v1.parallel_env, FieldArguments),
        (field_v1.team_env, FieldArguments),
    ],
)
def test_environments_show_the_signature_of_their_arguments(constructor, arguments):
    assert inspect.signature(constructor) == inspect.signature(arguments)


def test_the_documented_constructors_are_the_classes_themselves():
    assert planar_v1.parallel_env is PlanarEnv
    assert planar_v1.team_env is PlanarTeamEnv


@pytest.mark.parametrize(
    "constructor", [planar_v1.parallel_env, planar_v1.team_env, partial(planar_v1.vector_env, 2)]
)
def test_an_unknown_argument_is_answered_by_the_nearest_and_all_of_them(constructor):
    wanted = "planar_v1 has no argument 'robots'; did you mean 'n_robots'? It takes n_robots, "
    with pytest.raises(TypeError, match=re.escape(wanted)):
        constructor(robots=3)


def test_arguments_may_be_given_in_their_order():
    team = PlanarTeamEnv(3, "candidates", max_scans=5)
    assert team.action_space.shape == (3,)
    assert team.parallel.max_scans == 5
    env = PlanarEnv(3, "candidates", max_scans=5)
    assert len(env.possible_agents) == 3
    assert env.action_space("robot_2").n == PlanarArguments.n_candidates
    assert env.max_scans == 5
