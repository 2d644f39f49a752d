"""The whole search, and the record that is kept of it."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.files import read_json, write_atomically
from coopmap_env.core.settings import PositiveInt, Settings, settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.studies.section3.deviation import deviation_interval
from coopmap_env.studies.section3.setting import SEARCHES
from coopmap_env.studies.section3.table_fit.episodes import (
    STARTS,
    Columns,
    mean_columns,
    play_jobs,
)
from coopmap_env.studies.section3.table_fit.flatness import (
    PROFILE_FACTORS,
    TOLERANCE,
    compare_points,
    moved_constants,
    near_optimal_ranges,
    profile_points,
)
from coopmap_env.studies.section3.table_fit.objective import Fit
from coopmap_env.studies.section3.table_fit.points import RANGES, constants_at
from coopmap_env.studies.section3.table_fit.search import (
    count_trials,
    describe_setup,
    importances,
    least_value,
    open_search,
    ranked_points,
    run_search,
)

RECORD = Path(__file__).parent / "record.json"
"""Record of the search that found the defaults of `TableConstants`. It was smaller than a default
`SearchSize`, and began at the best trials of earlier runs: the record says how large it was, and
its notes how it began."""
FIRST_SEARCH_SEED, FIRST_FINAL_SEED, FIRST_PROFILE_SEED = 100, 730_000, 731_000
"""Seeds of the training worlds of the trials, of the choice among the best, and of the profile."""


@dataclass(frozen=True)
class SearchSize(Settings):
    """How much is played."""

    trials: PositiveInt = 400
    worlds: PositiveInt = 16
    """Training worlds of a trial."""
    finalists: PositiveInt = 6
    """Best trials that are played again on other training worlds, which choose among them."""
    final_worlds: PositiveInt = 48
    profile_worlds: PositiveInt = 48
    """Training worlds of the profile around the optimum."""


def fit_table(
    out: Path,
    size: SearchSize,
    base: PlanarSettings,
    workers: int,
    log: Callable[[str], None],
    progress: bool = True,
) -> dict[str, Any]:
    """Search, choose among the best, and look around the optimum.

    Parameters
    ----------
    out : Path
        Folder of the trials and of all columns. After an interruption the same call continues.
    size : SearchSize
    base : PlanarSettings
        Has what is not searched, such as the readings of Eqs. 7 and 8a.
    workers : int
        Processes of all but the trials, which follow one another.
    log : callable
        Receives lines of progress.
    progress : bool
        Show progress bars.

    Returns
    -------
    dict
        The record, as JSON values; also written to ``record.json``.
    """
    search_seeds, final_seeds, profile_seeds = (
        range(first, first + n)
        for first, n in (
            (FIRST_SEARCH_SEED, size.worlds),
            (FIRST_FINAL_SEED, size.final_worlds),
            (FIRST_PROFILE_SEED, size.profile_worlds),
        )
    )
    store = out / "columns"
    study = open_search(out, describe_setup(search_seeds, base))
    run_search(study, size.trials, search_seeds, base, log)
    log(f"the {size.finalists} best trials on {size.final_worlds} other training worlds")
    ranked = ranked_points(study)
    finalists = [point for _, point in ranked[: size.finalists]]
    constants = [constants_at(point) for point in finalists]
    finals = play_jobs(constants, final_seeds, base, store, workers, progress)
    values = [Fit.from_means(mean_columns(columns)).value for columns in finals]
    chosen = int(np.argmin(values))
    best = finalists[chosen]
    log("the profile around the optimum")
    moved = profile_points(best)
    at_best, *others = play_jobs(
        [constants_at(best), *(moved_constants(best, *one) for one in moved)],
        profile_seeds,
        base,
        store,
        workers,
        progress,
    )
    ranges = near_optimal_ranges(ranked)
    record = {
        "split": "train",
        "base": settings_to_dict(base),
        "version": __version__,
        "trials": count_trials(study),
        "complete_trials": len(ranked),
        "seeds": {
            "search": [search_seeds.start, search_seeds.stop],
            "choice": [final_seeds.start, final_seeds.stop],
            "profile": [profile_seeds.start, profile_seeds.stop],
        },
        "searched": {name: list(one) for name, one in RANGES.items()},
        "point": best,
        "constants": asdict(constants[chosen]),
        "fit": _fit_record(finals[chosen]),
        "least_values": {start: least_value(study, start) for start in STARTS},
        "importances": dict(importances(study)),
        "near_optimal": {"tolerance": TOLERANCE, "ranges": ranges},
        "profile_factors": list(PROFILE_FACTORS),
        "profile": {
            name: [point.as_dict() for point in points]
            for name, points in compare_points(moved, others, at_best).items()
        },
        "notes": [],
    }
    write_atomically(out / "record.json", json.dumps(record, indent=1) + "\n")
    return record


def read_record() -> dict[str, Any]:
    """The record of the search that found the defaults of `TableConstants`."""
    record: dict[str, Any] = read_json(RECORD)
    return record


def _fit_record(columns: Columns) -> dict[str, Any]:
    scores = np.stack([columns[search][:, :3] for search in SEARCHES], axis=1)
    interval = deviation_interval(scores, np.random.default_rng(BOOTSTRAP_SEED))
    means = mean_columns(columns)
    return {
        **Fit.from_means(means).as_dict(),
        "deviation_interval": interval.as_dict(),
        "means": {str(search): values.round(4).tolist() for search, values in means.items()},
    }
