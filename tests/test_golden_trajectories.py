"""What the environments do, compared with what they did when the hashes were recorded."""

import json
from pathlib import Path

import pytest
from plain.golden import (
    MODES,
    N_EPISODES,
    N_PLAYED,
    OLD_PROCESSOR,
    PARTS,
    SCANS,
    first_hashes_with,
    hashes_of,
    planner_hashes,
    trajectory_hashes,
)

from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.envs.registration import ENVS

FOLDER = Path(__file__).parent / "golden"
GOLDEN = json.loads((FOLDER / "trajectories.json").read_text())
V0 = json.loads((FOLDER / "trajectories_v0.json").read_text())


def test_every_registered_id_and_mode_has_hashes_of_a_hundred_episodes():
    assert set(SCANS) == set(ENVS) == set(GOLDEN)
    assert {len(GOLDEN[env_id][mode].split()) for env_id in SCANS for mode in MODES} == {100}
    assert N_EPISODES == 100


@pytest.mark.parametrize("part", PARTS)
@pytest.mark.parametrize("env_id", SCANS)
def test_trajectories_and_decisions_of_planners_are_those_that_were_recorded(env_id, part):
    if "Field" in env_id:
        pytest.importorskip("pybullet")
    found = hashes_of(env_id, part, N_PLAYED[env_id])
    recorded = GOLDEN[env_id][part].split()[: len(found)]
    pairs = zip(found, recorded, strict=True)
    assert [seed for seed, (now, then) in enumerate(pairs) if now != then] == []


@pytest.mark.long
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("env_id", ["coopmap/Field-v1", "coopmap/FieldSearch-v1"])
def test_all_trajectories_of_the_field_are_those_that_were_recorded(env_id, mode):
    pytest.importorskip("pybullet")
    assert hashes_of(env_id, mode) == GOLDEN[env_id][mode].split()


V0_ARGUMENTS = {
    "coopmap/Planar-v1": {"settings": PlanarSettings.v0()},
    "coopmap/Field-v1": {"settings": FieldSettings.v0(), "motion_correction": "encoders"},
    "coopmap/FieldSearch-v1": {"settings": FieldSettings.v0()},
}


@pytest.mark.parametrize("part", [*MODES, "rating_function", "information_gain"])
@pytest.mark.parametrize("env_id", SCANS)
def test_settings_of_v0_give_the_trajectories_that_were_recorded(env_id, part):
    """In the field those of v0 itself; the planar step has other random numbers since."""
    if "Field" in env_id:
        pytest.importorskip("pybullet")
    recorded = V0[env_id.replace("v1", "v0")][part].split()[: N_PLAYED[env_id] // 4]
    play = trajectory_hashes if part in MODES else planner_hashes
    assert play(env_id, part, len(recorded), **V0_ARGUMENTS[env_id]) == recorded


OTHER_PROCESS = {
    "PYTHONHASHSEED": "7",
    "LC_ALL": "C",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
}
"""Another hash seed, locale and number of threads."""
VARIANTS = {"an old processor and another process": {**OLD_PROCESSOR, **OTHER_PROCESS}}
LONG_VARIANTS = {
    "an old processor": OLD_PROCESSOR,
    "another process": OTHER_PROCESS,
    **{
        f"OpenBLAS for {name}": {"OPENBLAS_CORETYPE": name}
        for name in ("Nehalem", "Sandybridge", "Haswell", "Zen")
    },
    "numba for any processor": {**OLD_PROCESSOR, "NUMBA_CPU_NAME": "generic"},
    "numba without fused multiply-add": {"NUMBA_CPU_NAME": "nehalem", "NUMBA_CPU_FEATURES": ""},
}


@pytest.mark.parametrize(
    "variables",
    [
        *(pytest.param(value, id=name) for name, value in VARIANTS.items()),
        *(
            pytest.param(value, id=name, marks=pytest.mark.long)
            for name, value in LONG_VARIANTS.items()
        ),
    ],
)
def test_a_trajectory_is_the_same_to_the_last_bit_on_other_processors(variables, tmp_path):
    pytest.importorskip("pybullet")
    if "NUMBA_CPU_NAME" in variables:  # numba's cache knows the processor, but not its features
        variables = {**variables, "NUMBA_CACHE_DIR": str(tmp_path)}
    found = first_hashes_with(variables, list(SCANS), n_episodes=2)
    for env_id, hashes in found.items():
        for name, played in hashes.items():
            assert GOLDEN[env_id][name].startswith(played), f"{env_id} {name}"
