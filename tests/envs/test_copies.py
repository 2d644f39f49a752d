"""Copies in the middle of an episode go on as the original does."""

import copy
import hashlib
import pickle

import gymnasium
import numpy as np
import pettingzoo
import pytest
from plain.rollouts import MODES, random_actions, update_hash
from plain.small_worlds import small_world

from coopmap_env import families, field_v1, planar_v1
from coopmap_env.envs.registration import ENVS

IDS = [*ENVS, *(family.env_id for family in families.FAMILIES.values())]
COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda env: pickle.loads(pickle.dumps(env))}
by_either_way = pytest.mark.parametrize("copied", COPIES.values(), ids=COPIES)


@pytest.fixture(params=IDS)
def name(request):
    if "Field" in request.param:
        pytest.importorskip("pybullet")
        pytest.importorskip("small_gicp")
    return request.param


def arguments_of(name, mode):
    own = {"max_scans": 3} if name in ENVS else {}
    return {"action_mode": mode, "n_candidates": 4, **own}


def hash_of(*shown):
    sha = hashlib.sha256()
    update_hash(sha, shown)
    return sha.hexdigest()


def rest(env, n_steps, rng=1):
    """Hash of all that a parallel environment gives from now on, over some steps and a reset."""
    rng, shown = np.random.default_rng(rng), [env.state()]
    for _ in range(n_steps):
        if env.agents:
            shown += [env.step(random_actions(env, rng)), env.state()]
    map_ = env.belief().map
    shown += [map_.log_odds_fixed.copy(), map_.sampled_mask.copy(), env.reset()]
    return hash_of(*shown)


@pytest.mark.parametrize(("mode", "way"), list(zip(MODES, COPIES, strict=True)))
def test_of_every_id_the_robots_go_on_from_where_they_are(name, mode, way):
    env = pettingzoo.make("parallel", name, **arguments_of(name, mode)).unwrapped
    env.reset(seed=3)
    env.step(random_actions(env, np.random.default_rng(0)))
    other = COPIES[way](env)
    assert rest(other, 2) == rest(env, 2)
    env.close()
    other.close()


@pytest.mark.parametrize(("mode", "way"), list(zip(MODES, reversed(COPIES), strict=True)))
def test_of_every_id_the_team_goes_on_from_where_it_is(name, mode, way):
    env = gymnasium.make(name, **arguments_of(name, mode))
    env.reset(seed=3)
    env.action_space.seed(5)
    env.step(env.action_space.sample())
    other = COPIES[way](env)
    shown = []
    for one in other, env:
        action = one.action_space.sample()
        shown.append(hash_of(action, *one.step(action), one.unwrapped.parallel.state()))
        one.close()
    assert shown[0] == shown[1]
    assert other.spec == env.spec


@by_either_way
def test_stepped_physics_and_fiducials_go_on_too(copied):
    pytest.importorskip("pybullet")
    settings = field_v1.FieldSettings(physics="stepped")
    env = field_v1.parallel_env(motion_correction="fiducials", settings=settings, max_scans=4)
    env.reset(seed=0)
    for _ in range(2):
        env.step(random_actions(env, np.random.default_rng(0)))
    other = copied(env)
    assert rest(other, 1) == rest(env, 1)
    env.close()
    other.close()


@by_either_way
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("n_steps", [None, 0, 2, 4])
def test_from_any_place_and_independently_of_the_original(copied, mode, n_steps):
    """Before a reset (None), after it, in the middle and after the end."""
    env = small_world(action_mode=mode, n_robots=3, report_shown=True)
    rng = np.random.default_rng(0)
    if n_steps is not None:
        env.reset(seed=7)
        for _ in range(n_steps):
            env.step(random_actions(env, rng))
    other, third = copied(env), copied(env)
    assert other.agents == env.agents
    if n_steps is None:
        for one in env, other, third:
            one.reset(seed=7)
    expected = rest(env, 4)
    assert rest(other, 4) == expected
    assert rest(copied(third), 4) == expected


def test_trails_are_kept_and_no_window_is_opened():
    pytest.importorskip("PIL")
    env = small_world(render_mode="rgb_array")
    env.reset(seed=0)
    for _ in range(2):
        env.step(random_actions(env, np.random.default_rng(0)))
    np.testing.assert_array_equal(copy.deepcopy(env).render(), env.render())


def test_actions_that_are_changed_afterwards_are_kept_as_they_were_played():
    env = small_world(n_robots=1)
    env.reset(seed=0)
    action = np.array([0.5, 0.0, 0.5])
    env.step({"robot_0": action})
    action[:] = np.nan
    assert rest(copy.deepcopy(env), 2) == rest(env, 2)


def test_a_copied_team_has_the_same_masks():
    env = planar_v1.team_env(action_mode="candidates", n_candidates=500)
    env.reset(seed=0)
    np.testing.assert_array_equal(copy.deepcopy(env).action_masks(), env.action_masks())
