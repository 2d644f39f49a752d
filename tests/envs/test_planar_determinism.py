import os
import pickle
import subprocess
import sys
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from plain.rollouts import MODES, env_trajectory_hash, random_rollout, trajectory_hash, update_hash

from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.simulation.scenes.planar import Rooms

SEED = 5


def small(mode, **changes):
    return {"action_mode": mode, "max_scans": 6, "n_candidates": 8} | changes


@pytest.mark.parametrize("n_robots", [1, 3])
@pytest.mark.parametrize("mode", MODES)
def test_a_seed_decides_everything_that_an_episode_shows(mode, n_robots, scene):
    arguments = small(mode, n_robots=n_robots, scene=scene)
    assert env_trajectory_hash(arguments, SEED) == env_trajectory_hash(arguments, SEED)
    assert env_trajectory_hash(arguments, SEED) != env_trajectory_hash(arguments, SEED + 1)


@pytest.mark.parametrize("mode", MODES)
def test_earlier_episodes_leave_no_trace(mode):
    used, expected = PlanarEnv(**small(mode)), env_trajectory_hash(small(mode), SEED)
    for seed in (1, 2):
        trajectory_hash(used, seed)
    assert trajectory_hash(used, SEED) == expected
    next(random_rollout(used, 3, np.random.default_rng(0)))  # an episode that ends before its time
    assert trajectory_hash(used, SEED) == expected


@pytest.mark.parametrize("library", [pickle, cloudpickle])
@pytest.mark.parametrize("mode", MODES)
def test_a_pickled_environment_plays_the_same_episode(mode, library):
    arguments = small(mode, scene=Rooms(furniture=0.5), settings=PlanarSettings(n_headings=12))
    env = PlanarEnv(**arguments)
    trajectory_hash(env, 1)
    copied = library.loads(library.dumps(env))
    assert trajectory_hash(copied, SEED) == env_trajectory_hash(arguments, SEED)


@pytest.mark.parametrize("mode", MODES)
def test_another_process_with_other_string_hashes_plays_the_same_episode(mode):
    arguments = small(mode)
    code = (
        "from plain.rollouts import env_trajectory_hash; "
        f"print(env_trajectory_hash({arguments!r}, {SEED}))"
    )
    path = os.pathsep.join([str(Path(__file__).parents[1]), *filter(None, sys.path)])
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "271828"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.split() == [env_trajectory_hash(arguments, SEED)]


def test_without_a_seed_the_last_one_decides_the_next_episodes():
    def worlds(env):
        for _ in range(3):
            env.reset()
            yield env.truth.occupied

    first, second = PlanarEnv(), PlanarEnv()
    first.reset(seed=SEED)
    second.reset(seed=SEED)
    made = [first.truth.occupied, *worlds(first)]
    np.testing.assert_array_equal(made[1:], list(worlds(second)))
    assert len({world.tobytes() for world in made}) == 4
    unseeded = [PlanarEnv(), PlanarEnv()]
    assert len({world.tobytes() for env in unseeded for world in worlds(env)}) == 6


def test_splits_make_different_worlds_of_the_same_seed():
    worlds = set()
    for split in ("train", "validation", "test"):
        env = PlanarEnv(split=split)
        env.reset(seed=SEED)
        worlds.add(env.truth.occupied.tobytes())
    assert len(worlds) == 3


@pytest.mark.parametrize("mode", MODES)
def test_reading_state_belief_and_pictures_changes_nothing(mode):
    pytest.importorskip("PIL")

    def read_everything(env):
        env.state()
        env.belief().feasible_cells(0)
        env.render()

    env = PlanarEnv(**small(mode, render_mode="rgb_array"))
    assert trajectory_hash(env, SEED, read_everything) == env_trajectory_hash(small(mode), SEED)


def test_the_hash_distinguishes_types_and_bits():
    import hashlib

    values = [
        1, 1.0, np.float64(1.0), np.float32(1.0), True, "1", np.array([1.0]), np.array([[1.0]]),
        np.array([1.0], dtype=np.float32), {"a": 1}, {"b": 1}, {"a": np.nextafter(1.0, 2.0)},
    ]  # fmt: skip
    digests = set()
    for value in values:
        sha = hashlib.sha256()
        update_hash(sha, value)
        digests.add(sha.hexdigest())
    assert len(digests) == len(values)
