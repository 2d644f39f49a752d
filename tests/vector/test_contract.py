"""What every vector environment promises, beside gymnasium's loop and single environments."""

from functools import partial

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from plain.vector_rows import (
    SingleTeams,
    assert_same,
    assert_same_infos,
    gymnasium_loop,
)

from coopmap_env import field_v1, planar_v1
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import Obstacles
from coopmap_env.vector import WorkerVectorEnv

PLANAR = {
    "scene": Obstacles(shape=(24, 24), side_min=2.0, side_max=6.0),
    "settings": planar_v1.PlanarSettings(
        camera=PlanarCamera(depth_of_field=6.0, n_beams=16),
        reach=4.0,
        initial_free_radius=1.0,
        max_start_distance=6.0,
        crop_cells=8,
    ),
    "n_candidates": 300,  # more than a start offers: some are masked
    "max_scans": 3,
    "report_shown": True,
}
FIELD = {
    "settings": field_v1.FieldSettings(crop_cells=(8, 4)),
    "n_candidates": 3,
    "max_scans": 2,
    "report_shown": True,
}
N_WORLDS, N_STEPS = 3, 6


def modules():
    return {"planar": (planar_v1, PLANAR), "field": (field_v1, FIELD)}


def actions_of(env, rng):
    """Random actions of all rows, masked ones too."""
    n = env.single_action_space
    if env.action_space.dtype.kind == "i":
        return rng.integers(0, 3, env.action_space.shape)
    return rng.uniform(-1, 1, (env.num_envs, *n.shape)).astype(np.float32)


KINDS = [
    ("planar", "pose", 1, 0),
    ("planar", "candidates", 2, 2),
    ("planar", "pose", 3, 2),
    ("field", "candidates", 1, 0),
    ("field", "pose", 2, 2),
    ("field", "candidates", 3, 0),
]
"""World, action mode, number of robots, number of workers."""


@pytest.fixture(params=KINDS, ids=lambda kind: "-".join(map(str, kind)))
def kind(request):
    """Module, arguments and number of workers."""
    name, mode, n_robots, workers = request.param
    if name == "field":
        pytest.importorskip("pybullet")
    module, arguments = modules()[name]
    return module, {**arguments, "action_mode": mode, "n_robots": n_robots}, workers


def workers_option(module, workers):
    """Worker processes of the field, threads of the plane."""
    is_planar = module is planar_v1
    return {"num_threads": max(workers, 1)} if is_planar else {"num_workers": workers}


def test_rows_of_agents_are_single_environments_across_resets(kind):
    module, arguments, workers = kind
    env = module.vector_env(
        N_WORLDS,
        autoreset_mode="SameStep",
        with_state=True,
        **workers_option(module, workers),
        **arguments,
    )
    plain = SingleTeams(partial(module.parallel_env, **arguments), N_WORLDS)
    rng = np.random.default_rng(0)
    observations, infos = env.reset(seed=[5, 2, 9])
    expected, expected_infos = plain.reset([5, 2, 9])
    for _ in range(N_STEPS):
        state = observations.pop("state")
        np.testing.assert_array_equal(
            state, np.repeat([one.state() for one in plain.envs], len(env.robots), axis=0)
        )
        assert_same(observations, expected)
        for key in ("n_scans", "observed_fraction"):
            np.testing.assert_array_equal(infos[key], [info[key] for info in expected_infos])
        actions = actions_of(env, rng)
        observations, rewards, terminated, truncated, infos = env.step(actions)
        expected, paid, ends, last, expected_infos = plain.step(actions)
        assert rewards.dtype == np.float64
        np.testing.assert_array_equal(rewards, paid)
        np.testing.assert_array_equal(truncated, ends)
        assert not terminated.any()
        assert ("final_obs" in infos) == any(ends)
        for row in np.flatnonzero(ends):
            final = dict(infos["final_obs"][row])
            final.pop("state")
            assert_same(final, last[row])
    env.close()
    plain.close()


@pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.value)
def test_rows_of_teams_are_gymnasium_s_loop_of_team_environments(kind, mode):
    module, arguments, workers = kind
    if mode is not AutoresetMode.NEXT_STEP:
        workers = 0  # whose start takes longer than the rest
    env = module.vector_env(
        N_WORLDS, rows="teams", autoreset_mode=mode, **workers_option(module, workers), **arguments
    )
    plain = gymnasium_loop(partial(module.team_env, **arguments), N_WORLDS, mode)
    assert env.single_observation_space == plain.single_observation_space
    assert env.single_action_space == plain.single_action_space
    assert env.observation_space == plain.observation_space
    assert env.action_space == plain.action_space
    rng = np.random.default_rng(1)
    ours, theirs = env.reset(seed=4), plain.reset(seed=4)
    for step in range(N_STEPS):
        assert_same(ours[0], theirs[0])
        assert_same_infos(ours[-1], theirs[-1])
        actions = actions_of(env, rng)
        ours, theirs = env.step(actions), plain.step(actions)
        for one, other in zip(ours[1:4], theirs[1:4], strict=True):
            np.testing.assert_array_equal(one, other)
            assert one.dtype == other.dtype
        ended = ours[3].copy()
        if mode is AutoresetMode.DISABLED and (ended.any() or step == 1):
            mask = ended if ended.any() else np.array([True, False, False])  # or one in between
            seeds = [int(seed) for seed in rng.integers(99, size=N_WORLDS)]
            ours = env.reset(seed=seeds, options={"reset_mask": mask})
            theirs = plain.reset(seed=seeds, options={"reset_mask": mask})
    env.close()
    plain.close()


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_worlds_that_end_at_different_steps_are_reset_by_themselves(mode):
    arguments = {**PLANAR, "action_mode": "candidates"}
    env = planar_v1.vector_env(N_WORLDS, rows="teams", autoreset_mode=mode, **arguments)
    plain = gymnasium_loop(partial(planar_v1.team_env, **arguments), N_WORLDS, mode)
    rng = np.random.default_rng(2)
    env.reset(seed=4), plain.reset(seed=4)
    env.step(actions := actions_of(env, rng)), plain.step(actions)
    mask = np.array([False, True, False])
    ours = env.reset(options={"reset_mask": mask})
    theirs = plain.reset(options={"reset_mask": mask})
    for _ in range(N_STEPS):
        assert_same(ours[0], theirs[0])
        assert_same_infos(ours[-1], theirs[-1])
        actions = actions_of(env, rng)
        ours, theirs = env.step(actions), plain.step(actions)
        for one, other in zip(ours[1:4], theirs[1:4], strict=True):
            np.testing.assert_array_equal(one, other)


def test_workers_and_buffers_change_nothing():
    arguments = {**PLANAR, "action_mode": "candidates"}
    shown = []
    for workers in (0, 1, 2):
        env = WorkerVectorEnv(
            partial(planar_v1.parallel_env, **arguments), N_WORLDS, num_workers=workers,
            double_buffer=workers == 1,
        )  # fmt: skip
        rng, own = np.random.default_rng(3), []
        own.append({k: v.copy() for k, v in env.reset(seed=1)[0].items()})
        for _ in range(N_STEPS):
            observations, rewards, *ends, infos = env.step(actions_of(env, rng))
            own.append({key: values.copy() for key, values in observations.items()})
            flat = {k: v.copy() for k, v in infos.items() if isinstance(v, np.ndarray)}
            own.append({"rewards": rewards.copy(), "ends": np.array(ends), **flat})
        shown.append(own)
        env.close()
    for own in shown[1:]:
        for ours, theirs in zip(own, shown[0], strict=True):
            assert_same(ours, theirs)
