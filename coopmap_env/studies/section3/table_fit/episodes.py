"""Playing the searches of Table 1 with some constants, and measuring what the team observed."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_baselines import RasterPolicy, RatingFunctionPolicy
from coopmap_env.core.settings import settings_from_dict, settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation import MappedExtent, Policy, rollout, run_jobs
from coopmap_env.studies.section3.setting import (
    RASTER,
    SCANS_EACH,
    SEARCHES,
    TableConstants,
    section3_scene,
    section3_settings,
)
from coopmap_env.studies.section3.table_fit.nearest_first import NearestFirstPolicy

ALL_SEARCHES = (RASTER, *SEARCHES)
COLUMNS = ("max_radius", "mean_radius", "radius_std", "coverage")
"""What is measured of an episode: Table 1's columns in cells, and the observed fraction."""
STARTS = ("center", "first")
"""What distances are measured from: the mean of the robots' start positions, or the first one."""
Columns = dict[int | str, NDArray[np.float64]]
"""By search, shape (n_worlds, 4)."""


def make_search(search: int | str) -> Policy:
    """The policy of a search of Table 1; all choose as those of `make_policy` do."""
    if search == RASTER:
        return RasterPolicy()
    return RatingFunctionPolicy(search) if isinstance(search, int) else NearestFirstPolicy()


def make_env(
    constants: TableConstants, base: PlanarSettings | None = None, split: str = "train"
) -> PlanarEnv:
    """The environment of some constants."""
    return PlanarEnv(
        scene=section3_scene(constants),
        settings=section3_settings(constants, base),
        split=split,
        max_scans=SCANS_EACH,
    )


def play(env: PlanarEnv, search: int | str, seed: int) -> dict[str, list[float]]:
    """`COLUMNS` of one episode, measured from each of `STARTS`."""
    steps = rollout(env, make_search(search), seed)
    positions = env.belief().positions
    starts = dict(zip(STARTS, (positions.mean(axis=0), positions[0]), strict=True))
    for _ in steps:
        pass
    map_, columns = env.belief().map, {}
    for name, start in starts.items():
        extent = MappedExtent.from_map(map_, start)
        radii = [extent.max_radius, extent.mean_radius, extent.radius_std]
        columns[name] = [*radii, map_.observed_fraction]
    return columns


def play_all(
    constants: TableConstants,
    seeds: Sequence[int],
    base: PlanarSettings | None = None,
    after_world: Callable[[int, dict[str, Columns]], None] = lambda n, columns: None,
    split: str = "train",
) -> dict[str, Columns]:
    """Columns of all searches on the same worlds, measured from each of `STARTS`.

    Parameters
    ----------
    constants : TableConstants
    seeds : sequence of int
        Of the worlds.
    base : PlanarSettings, optional
        Has what is not among the constants, such as the readings of Eqs. 7 and 8a.
    after_world : callable
        Gets the number of worlds so far and their columns, and may raise an error to end.
    split : str
    """
    env = make_env(constants, base, split)
    rows: dict[str, dict[int | str, list[list[float]]]] = {
        start: {search: [] for search in ALL_SEARCHES} for start in STARTS
    }
    for n, seed in enumerate(seeds, start=1):
        for search in ALL_SEARCHES:
            for start, values in play(env, search, seed).items():
                rows[start][search].append(values)
        after_world(n, _as_arrays(rows))
    return _as_arrays(rows)


def mean_columns(columns: Columns) -> Columns:
    """Means over the worlds, shape (4,) of each search."""
    return {search: values.mean(axis=0) for search, values in columns.items()}


def _as_arrays(rows: Mapping[str, Mapping[int | str, Sequence[Any]]]) -> dict[str, Columns]:
    return {
        start: {search: np.array(values) for search, values in by_search.items()}
        for start, by_search in rows.items()
    }


def play_job(job: dict[str, Any]) -> dict[str, Any]:
    """`play_all` from JSON values to JSON values, for `run_jobs`; from the center of the starts."""
    columns = play_all(
        TableConstants(**job["constants"]),
        range(*job["seeds"]),
        settings_from_dict(job["base"], PlanarSettings),
    )
    return {str(search): rows.tolist() for search, rows in columns["center"].items()}


def play_jobs(
    choices: Sequence[TableConstants],
    seeds: range,
    base: PlanarSettings,
    store: Path,
    workers: int = 1,
    progress: bool = True,
) -> list[Columns]:
    """Columns of each of some constants on the same training worlds; see `run_jobs`."""
    jobs = [
        {
            "constants": asdict(constants),
            "seeds": [seeds.start, seeds.stop],
            "base": settings_to_dict(base),
            "version": __version__,
        }
        for constants in choices
    ]
    results = run_jobs(play_job, jobs, store, workers, progress)
    return [
        {search: np.array(result[str(search)]) for search in ALL_SEARCHES} for result in results
    ]
