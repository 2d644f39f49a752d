"""Nothing of the true world hangs on what policies get: the belief and the observations."""

import numpy as np
import pytest

from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.envs.planar.true_worlds import TrueWorlds
from coopmap_env.simulation import FieldSimulator, PlanarSimulator
from coopmap_env.simulation.scenes.field import FieldWorld, Solid
from coopmap_env.simulation.scenes.planar import PlanarWorld

TRUTH = (
    PlanarWorld, TrueWorlds, PlanarSimulator, FieldWorld, Solid, FieldSimulator,
    PlanarEnv, FieldEnv,
)  # fmt: skip


def reachable(thing, seen):
    """All objects that hang on one, by attributes and by membership."""
    if id(thing) in seen or isinstance(thing, type | str | bytes | int | float | np.ndarray):
        return
    seen[id(thing)] = thing
    parts = list(vars(thing).values()) if hasattr(thing, "__dict__") else []
    if isinstance(thing, dict):
        parts += [*thing.keys(), *thing.values()]
    elif isinstance(thing, list | tuple | set | frozenset):
        parts += list(thing)
    elif hasattr(thing, "__self__"):  # a method knows its object
        parts.append(thing.__self__)
    for cell in getattr(thing, "__closure__", None) or ():
        parts.append(cell.cell_contents)
    for part in parts:
        if not type(part).__module__.startswith(("numba", "llvmlite")):
            reachable(part, seen)


@pytest.mark.parametrize("mode", ["pose", "candidates"])
@pytest.mark.parametrize("world", ["planar", "field"])
def test_no_path_of_references_leads_from_the_belief_to_the_truth(world, mode):
    if world == "field":
        pytest.importorskip("pybullet")
        settings = FieldSettings(crop_cells=(8, 4))
        env = FieldEnv(action_mode=mode, n_candidates=4, settings=settings)
    else:
        env = PlanarEnv(action_mode=mode, n_candidates=4)
    observations, infos = env.reset(seed=0)
    seen = {}
    reachable((env.belief(), observations, infos), seen)
    assert len(seen) > 20
    assert [thing for thing in seen.values() if isinstance(thing, TRUTH)] == []
    # the walk finds the truth where it is
    found = {}
    reachable(env, found)
    assert any(isinstance(thing, TRUTH[:-2]) for thing in found.values())
    env.close()
