"""Upper bounds of worlds, in a folder that scores of all submissions share.

A file is named by the family, its definition and the world's hash, not by the seed: private worlds
have bounds, too. What is read is checked (`load_bound`): it cannot be too low. It can be needlessly
high, if somebody wrote it for that, and then efficiencies by it are too low. So the folder is the
user's own (`own_folder`), unless another one is named.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from coopmap_env.core.files import private_folder
from coopmap_env.envs import MappingEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Episode
from coopmap_env.evaluation.bounds import (
    Efficiency,
    PlanarViews,
    efficiency,
    kept_bound,
    scans_in_time,
)
from coopmap_env.families import Family, world_hash
from coopmap_env.families.worlds import definition_hash


def own_folder() -> Path:
    """Where the bounds that this user has searched are kept: nobody else can write there.

    Raises
    ------
    FileError
        See `private_folder`.
    """
    return private_folder() / "bounds"


def episode_efficiency(
    env: MappingEnv[Any], family: Family, seed: int, episode: Episode, folder: Path
) -> Efficiency | None:
    """Efficiency of an episode by the bound of its world; None if no bounds are known.

    Why a bound over scans is one over time is said in `coopmap_env.evaluation.bounds.efficiency`.

    Parameters
    ----------
    env : MappingEnv
        Of the family; it is reset.
    family : Family
    seed : int
        Of the world.
    episode : Episode
        With a `shown_curve`.
    folder : Path
        Of the bounds. One that is missing, or whose search was short, is searched and written.

    Raises
    ------
    BoundFileError
        If the file of the bound is broken, belongs to another world or other scans, or is wrong.
    """
    if not isinstance(env, PlanarEnv):
        return None
    env.reset(seed=seed)
    path = folder / f"{family.name}_{definition_hash(family)}_{world_hash(env)}.npz"
    n_scans = scans_in_time(env.max_scans, env.max_time, env.settings.scan_time)
    views = PlanarViews.from_env(env, n_scans)
    found = kept_bound(path, views, n_scans)
    n_cells = env.belief().map.grid.n_cells
    return efficiency(episode, found.bounds, n_cells, env.settings.scan_time)
