import os
import pickle
import subprocess
import sys
from pathlib import Path

import cloudpickle
import numpy as np
import pytest
from plain.rollouts import MODES, env_trajectory_hash, random_rollout, trajectory_hash

from coopmap_env.envs.field import FieldEnv, FieldSettings

pytest.importorskip("pybullet")

SEED = 5
PHYSICS = ("kinematic", "stepped")


def small(mode, physics="kinematic", **changes):
    settings = FieldSettings(physics=physics, crop_cells=(8, 4))
    return {
        "action_mode": mode,
        "max_scans": 3,
        "n_candidates": 4,
        "settings": settings,
    } | changes


@pytest.mark.parametrize("n_robots", [1, 3])
@pytest.mark.parametrize("mode", MODES)
def test_a_seed_decides_everything_that_an_episode_shows(mode, n_robots):
    arguments = small(mode, n_robots=n_robots)
    assert env_trajectory_hash(arguments, SEED, FieldEnv) == env_trajectory_hash(
        arguments, SEED, FieldEnv
    )
    assert env_trajectory_hash(arguments, SEED, FieldEnv) != env_trajectory_hash(
        arguments, SEED + 1, FieldEnv
    )


SEARCH = {"initialization": "search", "motion_correction": "fiducials", "max_scans": 5}


def test_a_seed_decides_the_search_and_what_fiducials_correct():
    arguments = small("candidates", **SEARCH)
    assert env_trajectory_hash(arguments, SEED, FieldEnv) == env_trajectory_hash(
        arguments, SEED, FieldEnv
    )
    used = FieldEnv(**arguments)
    trajectory_hash(used, 1)
    assert trajectory_hash(used, SEED) == env_trajectory_hash(arguments, SEED, FieldEnv)
    used.close()


@pytest.mark.parametrize("physics", PHYSICS)
def test_earlier_episodes_leave_no_trace(physics):
    arguments = small("pose", physics)
    used, expected = FieldEnv(**arguments), env_trajectory_hash(arguments, SEED, FieldEnv)
    trajectory_hash(used, 1)
    assert trajectory_hash(used, SEED) == expected
    next(random_rollout(used, 3, np.random.default_rng(0)))  # an episode that ends before its time
    assert trajectory_hash(used, SEED) == expected
    used.close()


@pytest.mark.parametrize("library", [pickle, cloudpickle])
def test_a_pickled_environment_plays_the_same_episode(library):
    arguments = small("candidates")
    env = FieldEnv(**arguments)
    trajectory_hash(env, 1)
    copied = library.loads(library.dumps(env))
    assert trajectory_hash(copied, SEED) == env_trajectory_hash(arguments, SEED, FieldEnv)
    env.close()
    copied.close()


@pytest.mark.parametrize("physics", PHYSICS)
def test_another_process_with_other_string_hashes_plays_the_same_episode(physics):
    code = (
        "from test_field_determinism import small; from plain.rollouts import env_trajectory_hash;"
        "from coopmap_env.envs.field import FieldEnv;"
        f"print(env_trajectory_hash(small('pose', {physics!r}), {SEED}, FieldEnv))"
    )
    here = Path(__file__).parent
    path = os.pathsep.join([str(here), str(here.parent), *filter(None, sys.path)])
    found = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "PYTHONPATH": path, "PYTHONHASHSEED": "271828"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert found.stdout.split()[-1] == env_trajectory_hash(small("pose", physics), SEED, FieldEnv)


def test_reading_state_belief_and_pictures_changes_nothing():
    pytest.importorskip("PIL")

    def read_everything(env):
        env.state()
        env.belief().feasible_poses(0)
        env.render()

    env = FieldEnv(**small("pose", max_scans=1, render_mode="rgb_array"))
    assert trajectory_hash(env, SEED, read_everything) == env_trajectory_hash(
        small("pose", max_scans=1), SEED, FieldEnv
    )
    env.close()
