"""What the environments do, compared with what they did when the hashes were recorded."""

import json
from pathlib import Path

import pytest
from plain.golden import MODES, N_EPISODES, PLANNERS, SCANS, hashes_elsewhere

from coopmap_env.envs.registration import ENVS

GOLDEN = json.loads((Path(__file__).parent / "golden" / "trajectories.json").read_text())


def test_every_registered_id_and_mode_has_hashes_of_a_hundred_episodes():
    assert set(SCANS) == set(ENVS) == set(GOLDEN)
    assert {len(GOLDEN[env_id][mode].split()) for env_id in SCANS for mode in MODES} == {100}
    assert N_EPISODES == 100


@pytest.mark.parametrize("env_id", SCANS)
def test_trajectories_and_decisions_of_planners_are_those_that_were_recorded(env_id):
    if "Field" in env_id:
        pytest.importorskip("pybullet")
    found = hashes_elsewhere(env_id)
    assert set(found) == {*MODES, *PLANNERS}
    differing = {}
    for name, hashes in found.items():
        pairs = zip(hashes.split(), GOLDEN[env_id][name].split(), strict=True)
        differing[name] = [seed for seed, (now, then) in enumerate(pairs) if now != then]
    assert differing == {name: [] for name in found}
