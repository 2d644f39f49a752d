"""Episodes as jobs: what later jobs reuse changes no result."""

import numpy as np
import pytest

from coopmap_env.envs.field import FieldSettings
from coopmap_env.evaluation import episode_jobs, make_env, make_policy, run_episode
from coopmap_env.evaluation.episode_jobs import make_job, run_job

ARGUMENTS = {"n_robots": 1, "max_scans": 2, "split": "train", "scene": "rubble"}
POLICIES = ("random", "coverage:search=5")


@pytest.fixture
def jobs():
    pytest.importorskip("pybullet")
    settings = FieldSettings()
    return [make_job(p, seed, ARGUMENTS, settings, "field") for p in POLICIES for seed in (3, 4)]


def test_the_evaluator_of_a_world_is_made_once_for_all_policies(jobs, monkeypatch):
    made = []

    def make_surface_evaluator(env, seed):
        made.append(seed)
        return make(env, seed)

    make = episode_jobs.make_surface_evaluator
    monkeypatch.setattr(episode_jobs, "make_surface_evaluator", make_surface_evaluator)
    for job in jobs:
        run_job({**job, "version": "of this test"})
    assert made == [3, 4]


def test_jobs_after_one_that_failed_are_scored_in_their_own_world(jobs):
    first, second = jobs[:2]
    expected = run_job({**second, "version": "another"})["surface"]
    run_job(first)
    others = [{**first, "version": f"other {k}"} for k in range(4)]
    for job in others[:3]:
        run_job(job)
    with pytest.raises(ValueError, match="search"):
        run_job({**others[3], "policy": "coverage:search=0"})
    np.testing.assert_equal(run_job(second)["surface"], expected)


def test_a_remembered_evaluator_gives_the_scores_of_a_new_one(jobs):
    env = make_env("field", ARGUMENTS, None)
    for job in (jobs[0], jobs[2]):  # two policies on one world
        surface = run_episode(env, make_policy(job["policy"]), job["seed"]).surface
        found = run_job(job)["surface"]
        np.testing.assert_equal(found, vars(surface))  # a map without walls has NaN scores
