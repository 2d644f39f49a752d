"""What the environments do, compared with what they did when the hashes were recorded."""

import json
from pathlib import Path

import pytest
from plain.golden import MODES, N_EPISODES, PLANNERS, SCANS, planner_hashes, trajectory_hashes

GOLDEN = json.loads((Path(__file__).parent / "golden" / "trajectories.json").read_text())


def needs_physics(env_id):
    if "Field" in env_id:
        pytest.importorskip("pybullet")


def test_every_registered_id_has_hashes():
    from coopmap_env.envs.registration import WORLDS

    assert set(SCANS) == set(WORLDS)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", SCANS)
def test_random_actions_lead_to_the_recorded_trajectories(env_id, mode):
    needs_physics(env_id)
    expected = GOLDEN[f"{env_id} {mode}"].split()
    assert len(expected) == N_EPISODES
    found = trajectory_hashes(env_id, mode)
    differing = [seed for seed in range(N_EPISODES) if found[seed] != expected[seed]]
    assert not differing


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("env_id", SCANS)
def test_planners_take_the_recorded_decisions(env_id, name):
    needs_physics(env_id)
    assert planner_hashes(env_id, name) == GOLDEN[f"{env_id} {name}"].split()
