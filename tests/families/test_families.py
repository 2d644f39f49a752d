"""Benchmark families: frozen tasks by name, ids and options."""

import json

import gymnasium
import numpy as np
import pettingzoo
import pytest

import coopmap_env
from coopmap_env import families
from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.replay import Replay
from coopmap_env.envs import registration
from coopmap_env.evaluation import get_env_spec
from coopmap_env.families.freeze import hashes_of
from coopmap_env.families.worlds import HASH_DIGITS, definition_hash, frozen_hashes

NAMES = sorted(families.FAMILIES)


@pytest.fixture(params=NAMES)
def family(request):
    found = families.get(request.param)
    if found.env_name == "field":
        pytest.importorskip("pybullet")
    return found


def test_every_family_is_registered_under_its_id():
    assert {
        name: family.env_name.capitalize() for name, family in families.FAMILIES.items()
    } == registration.FAMILIES
    for name, family in families.FAMILIES.items():
        assert family.name == name
        assert family.env_id in gymnasium.registry
        assert f"coopmap/{family.env_name.capitalize()}-{name}-v1" == family.env_id


def test_the_first_worlds_of_each_split_are_the_frozen_ones(family):
    hashes = frozen_hashes(family.name)
    assert hashes["definition"] == definition_hash(family)
    assert {split: len(hashes[split]) for split in families.N_WORLDS} == families.N_WORLDS
    n_played = {"train": 2, "validation": 1, "test": 3}
    found = hashes_of(family, n_played)
    for split, n in n_played.items():
        assert found[split] == hashes[split][:n]


def test_no_world_is_frozen_twice(family):
    hashes = frozen_hashes(family.name)
    worlds = [world for split in families.N_WORLDS for world in hashes[split]]
    assert len(set(worlds)) == len(worlds)
    assert {len(world) for world in worlds} == {HASH_DIGITS}


def test_a_world_is_checked_by_its_seed(family):
    env = family.make("test")
    env.reset(seed=1)
    families.check_world(family, env, 1)
    with pytest.raises(families.WorldMismatchError, match=r"world 0 of the split 'test'"):
        families.check_world(family, env, 0)
    with pytest.raises(families.WorldMismatchError, match=r"200 frozen worlds .* from seed 0 on"):
        families.check_world(family, env, 200)
    env.close()


def test_a_definition_is_json_and_makes_the_same_environment(family):
    definition = json.loads(json.dumps(family.definition))
    assert definition == family.definition
    spec = get_env_spec(definition["env"])
    env = spec.make(**definition["arguments"], settings=family.settings)
    assert env.max_scans == family.budget["max_scans"]
    assert env.max_time == family.budget.get("max_time")
    env.close()


def test_policies_choose_how_they_act_and_learn_and_nothing_else():
    env = families.make("crowded", "validation", action_mode="candidates", n_candidates=5)
    assert env.split == "validation"
    assert env.action_space("robot_0").n == 5
    for name in ("n_robots", "max_scans", "settings", "scene", "max_time"):
        with pytest.raises(ValueError, match=f"'crowded' has its own '{name}'; free are action_"):
            families.make("crowded", **{name: 3})
    with pytest.raises(ValueError, match="unknown family 'crowd'; did you mean 'crowded'"):
        families.make("crowd")
    with pytest.raises(ValueError, match="split"):
        families.make("crowded", split="tests")


def test_ids_make_parallel_and_team_environments():
    assert coopmap_env is not None
    parallel = pettingzoo.make("parallel", "coopmap/Planar-crowded-v1", split="test")
    team = gymnasium.make("coopmap/Planar-crowded-v1", split="test")
    own = families.make("crowded", split="test")
    registered, single = (env.reset(seed=3)[0] for env in (parallel, own))
    np.testing.assert_array_equal(registered["robot_1"]["map"], single["robot_1"]["map"])
    first, _ = team.reset(seed=3)
    own_map = single["robot_0"]["map"]
    np.testing.assert_array_equal(first["map"][: len(own_map)], own_map)


def test_many_worlds_are_those_of_single_environments():
    many = families.make_vector("crowded", 2, split="test", rows="teams", autoreset_mode="Disabled")
    own = families.make("crowded", split="test")
    observations, _ = many.reset(seed=[4, 5])
    for row in range(2):
        single, _ = own.reset(seed=4 + row)
        channels = len(single["robot_0"]["map"])
        np.testing.assert_array_equal(observations["map"][row, :channels], single["robot_0"]["map"])
    with pytest.raises(ValueError, match="has its own 'n_robots'"):
        families.make_vector("crowded", 2, n_robots=3)
    many.close()


def test_the_option_family_stands_for_scene_team_and_budget():
    family = families.get("motion-budget")
    options = EnvironmentOptions(
        family="motion-budget", action_mode="candidates", reward="coverage"
    )
    assert options.env_name == "planar"
    assert options.settings() == family.settings
    arguments = options.env_kwargs()
    assert arguments["max_time"] == family.budget["max_time"]
    assert (arguments["action_mode"], arguments["reward"]) == ("candidates", "coverage")
    env = options.make_env("test")
    env.reset(seed=0)
    families.check_world(family, env, 0)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("scene", "rooms"),
        ("max_scans", 3),
        ("max_scans", 16),  # the default of the environment
        ("n_robots", 2),
        ("max_time", 9.0),
        ("env", "field"),
        ("env", "planar"),
        ("physics", "kinematic"),
    ],
)
def test_what_a_family_has_of_its_own_is_no_option_beside_it(option, value):
    options = EnvironmentOptions(family="crowded", **{option: value})
    wanted = f"--{option.replace('_', '-')} belongs to --family crowded"
    with pytest.raises(ValueError, match=wanted):
        options.env_kwargs()


def test_a_replay_takes_families_of_both_kinds_of_world(tmp_path):
    assert Replay(out=tmp_path).env_name == "field"
    assert Replay(out=tmp_path, family="occluded").env_kwargs()["mount"] == "mast"
    assert Replay(out=tmp_path, family="crowded").env_name == "planar"


def test_an_unknown_family_is_an_error_of_one_line():
    with pytest.raises(ValueError, match="unknown family 'none'; choose from"):
        EnvironmentOptions(family="none").env_kwargs()


def test_a_family_cannot_be_changed():
    family = families.get("crowded")
    arguments = family.env_kwargs
    arguments["scene"]["shape"][0] = 60
    arguments["max_scans"] = 3
    assert family.env_kwargs["scene"]["shape"] == [100, 100]
    with pytest.raises(TypeError):
        family.scene["halls"] = 0.1
    with pytest.raises(TypeError):
        family.budget["max_scans"] = 3


@pytest.mark.parametrize("seed", [0.0, "0", None])
def test_a_seed_that_is_none_is_no_frozen_world(seed):
    env = families.make("crowded", "test")
    env.reset(seed=0)
    with pytest.raises(families.WorldMismatchError, match="200 frozen worlds"):
        families.check_world(families.get("crowded"), env, seed)
