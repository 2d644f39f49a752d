"""Infos: flat, numeric, and of the same form after a reset and after each step."""

import gymnasium
import numpy as np
import pettingzoo
import pytest
from plain.rollouts import MODES, random_actions

from coopmap_env import families, field_v1, planar_v1
from coopmap_env.envs import RejectedReason
from coopmap_env.envs.registration import ENVS
from coopmap_env.envs.step_data import REWARD_PREFIX
from coopmap_env.localization import CorrectionFailure, LocalizationFailure
from coopmap_env.robots.collision import _contact
from coopmap_env.robots.planar import reachable_regions

IDS = [*ENVS, *(family.env_id for family in families.FAMILIES.values())]
DTYPES = {bool: np.dtype(bool), int: np.dtype(np.int64), float: np.dtype(np.float64)}


def arguments_of(name, mode):
    """Short episodes; those of families are fixed."""
    own = {"max_scans": 2} if name in ENVS else {}
    return {"action_mode": mode, "n_candidates": 4, **own}


@pytest.fixture(params=IDS)
def name(request):
    if "Field" in request.param:
        pytest.importorskip("pybullet")
        pytest.importorskip("small_gicp")
    return request.param


@pytest.mark.parametrize("mode", MODES)
def test_infos_of_every_id_are_numbers_of_the_same_form_from_the_reset_on(name, mode):
    env = pettingzoo.make("parallel", name, **arguments_of(name, mode))
    types, rng = env.unwrapped.info_types, np.random.default_rng(0)
    assert set(types.values()) <= set(DTYPES)
    infos = env.reset(seed=0)[1]
    for _ in range(3):
        assert list(infos) == env.possible_agents
        for info in infos.values():
            assert {key: type(value) for key, value in info.items()} == dict(types)
            assert not any(np.isnan(value) for value in info.values())
        if not env.agents:
            break
        infos = env.step(random_actions(env.unwrapped, rng))[-1]
    env.close()


@pytest.mark.parametrize("mode", MODES)
def test_infos_of_every_team_are_arrays_of_the_same_form_from_the_reset_on(name, mode):
    env = gymnasium.make(name, **arguments_of(name, mode))
    robots = env.unwrapped.parallel
    shape = (len(robots.possible_agents),)
    form = {key: (DTYPES[t], shape) for key, t in robots.info_types.items()}
    shown = [env.reset(seed=0)[1], env.step(env.action_space.sample())[-1]]
    assert [{key: (own.dtype, own.shape) for key, own in info.items()} for info in shown] == [
        form, form
    ]  # fmt: skip
    env.close()


@pytest.mark.parametrize("rows", ["agents", "teams"])
@pytest.mark.parametrize("page", [planar_v1, field_v1], ids=["planar", "field"])
def test_infos_of_vector_environments_are_those_arrays_too(page, rows):
    if page is field_v1:
        pytest.importorskip("pybullet")
    env = page.vector_env(2, rows=rows, action_mode="candidates", n_candidates=4, max_scans=1)
    types = page.parallel_env(n_candidates=4).info_types
    shape = (4,) if rows == "agents" else (2, 2)
    for infos in env.reset(seed=0)[1], env.step(env.action_space.sample())[-1]:
        assert set(infos) == {part + key for key in types for part in ("", "_")}
        for key, kind in types.items():
            assert (infos[key].dtype, infos[key].shape) == (DTYPES[kind], shape)
            assert infos[f"_{key}"].all()
    env.close()


def test_before_the_first_step_nothing_has_come_of_it():
    env = planar_v1.parallel_env(max_scans=1)
    info = env.reset(seed=0)[1]["robot_1"]
    expected = {"n_scans", "elapsed_time", "rejected_reason", "collided", "distance", "new_cells"}
    assert {key for key in expected if info[key] == 0} == expected
    assert {value for key, value in info.items() if key.startswith(REWARD_PREFIX)} == {0.0}
    assert info["observed_fraction"] > 0
    assert env.explain("robot_1") == {}


@pytest.mark.parametrize("kind", [RejectedReason, LocalizationFailure, CorrectionFailure])
def test_codes_count_from_none_and_each_has_words_of_its_own(kind):
    assert [int(reason) for reason in kind] == list(range(len(kind)))
    assert kind(0).words == ""
    assert len({reason.words for reason in kind}) == len(kind)
    assert all(isinstance(reason, int) for reason in kind)


def test_codes_are_those_of_the_kernels():
    for name in ("OUTSIDE_WORLD", "GOAL_UNKNOWN", "GOAL_NOT_FREE", "NO_PATH"):
        assert getattr(RejectedReason, name) == getattr(reachable_regions, name)
    assert RejectedReason.NONE == reachable_regions.FEASIBLE
    masked = RejectedReason.MASKED
    assert masked + _contact.MAP_CONTACT == RejectedReason.TOUCHES_MAP
    assert masked + _contact.SELF_CONTACT == RejectedReason.TOUCHES_ITSELF
    assert masked + _contact.TEAM_CONTACT == RejectedReason.TOUCHES_TEAMMATE


def test_explain_needs_an_episode():
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        planar_v1.parallel_env().explain("robot_0")


def test_the_team_has_the_masks_of_its_robots_one_after_another():
    env = planar_v1.team_env(action_mode="candidates", n_candidates=500, max_scans=2)
    with pytest.raises(RuntimeError, match=r"call reset\(\) first"):
        env.action_masks()
    observation, _ = env.reset(seed=0)
    for _ in range(2):
        masks = env.action_masks()
        assert masks.shape == (1000,)
        assert masks.dtype == bool
        np.testing.assert_array_equal(masks, observation["action_mask"] == 1)
        offered = env.parallel.belief().candidates
        assert [half.sum() for half in np.split(masks, 2)] == [len(own) for own in offered]
        observation, *_ = env.step(env.action_space.sample())
    with pytest.raises(AttributeError, match="make it with action_mode='candidates'"):
        planar_v1.team_env().action_masks()
