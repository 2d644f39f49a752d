"""Play the rating function with many constants on training worlds; record what was found.

::

    python -m coopmap_env.studies.rating_constants.sweep results/rating-constants --workers 2
    cp results/rating-constants/*.json coopmap_env/studies/rating_constants/

The planner is the best of m = 100 random poses, each robot by itself. The criterion, fixed before
the search, of each environment:

K
    The largest of the sweep (n = 1, 64 bins) whose area under the coverage curve, a mean over the
    worlds, is at least 98 % of the largest area of the sweep. In the field it is the area under the
    curve of the covered surface. Motion costs time and, on a real mount, precision; the last two
    per cent of the area are not worth the motion that they take. (In the records K = 0 takes 1.36
    times the motion of the chosen K in the planar environment and 1.77 times in the field.)
n
    1, unless another exponent has a larger area at the motion of the chosen K and n = 1, with a
    paired 95 % interval that does not contain zero. Its K is swept too, as its unit differs, and
    the area at that motion lies between the two nearest K.
bins
    64, unless another number has a larger area with the chosen K and n = 1, with a paired 95 %
    interval that does not contain zero.

The best, the chosen and the next larger K, and other numbers of bins, are then played on other
training worlds. This part was added after the first had been seen, because an interval for 128 bins
only just excluded zero: a number of bins is chosen only if it is surely better there too.

After an interruption, the same command continues.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.files import write_atomically
from coopmap_env.core.locks import folder_lock
from coopmap_env.core.progress import log as log_line
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldSettings
from coopmap_env.envs.planar import PlanarSettings
from coopmap_env.evaluation import BOOTSTRAP_SEED, compare
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.studies.common.records import significant
from coopmap_env.studies.rating_constants.choice import (
    Trial,
    area_at_motion,
    best_area,
    difference,
    largest_good,
)

POLICY = "rating_function:search=100"
ENV_KWARGS = {"max_scans": 16, "split": "train"}
"""Two robots: 32 scans together."""
N_BINS = 64
OTHER_N_BINS = (32, 128)
SWEPT = ("K", "exponent", "n_gray_bins")
"""Fields of the rating settings that differ between the trials."""
RECORDS = Path(__file__).parent
"""Folder of the records from which the defaults come, one for each environment."""


@dataclass(frozen=True)
class Sweep:
    """What is played in one environment."""

    env_name: str
    settings: Any
    """`PlanarSettings` or `FieldSettings`."""
    area: str
    """Column of the area under the coverage curve."""
    n_worlds: int
    """Training worlds, with seeds from 0."""
    n_confirming: int
    """Other training worlds, with the seeds after those."""
    K: dict[float, tuple[float, ...]]
    """Values of K by exponent n."""


SWEEPS = (
    Sweep(
        "planar", PlanarSettings(), "coverage_auc", 96, 160,
        {
            1.0: (0.0, 0.005, 0.01, 0.02, 0.03, 0.05, 0.07, 0.1, 0.15, 0.2, 0.3),
            0.5: (0.02, 0.05, 0.1, 0.2, 0.4),
            2.0: (0.0005, 0.001, 0.002, 0.005, 0.01),
        },
    ),
    Sweep(
        "field", FieldSettings(), "surface_coverage_auc", 8, 8,
        {
            1.0: (0.0, 0.02, 0.05, 0.1, 0.2, 0.3),
            0.5: (0.1, 0.2, 0.4, 0.6),
            2.0: (0.02, 0.05, 0.1),
        },
    ),
)  # fmt: skip


def run_sweep(
    store: Path, sweep: Sweep, workers: int, log: Callable[[str], None]
) -> dict[str, Any]:
    """Play all constants of a sweep; what was found, as JSON values.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not played again.
    sweep : Sweep
    workers : int
        Processes; the record does not depend on it.
    log : callable
        Receives a line of progress.
    """
    first, other = range(sweep.n_worlds), range(sweep.n_worlds, sweep.n_worlds + sweep.n_confirming)

    def play(K: float, exponent: float, n_gray_bins: int = N_BINS, seeds: range = first) -> Trial:
        log(f"{sweep.env_name}: K {K:g}, n {exponent:g}, {n_gray_bins} bins, {len(seeds)} worlds")
        rating = replace(sweep.settings.rating, K=K, exponent=exponent, n_gray_bins=n_gray_bins)
        settings = replace(sweep.settings, rating=rating)
        table = compare(
            [POLICY], seeds, ENV_KWARGS, store, settings, workers, False, sweep.env_name
        )[POLICY].table  # fmt: skip
        return Trial(rating, table[sweep.area], table["motion_distance"])

    trials = [play(K, 1.0) for K in sweep.K[1.0]]
    chosen = largest_good(trials)
    by_exponent = {n: [play(K, n) for K in values] for n, values in sweep.K.items() if n != 1.0}
    by_bins = {n: play(chosen.constants.K, 1.0, n) for n in OTHER_N_BINS}
    K = chosen.constants.K
    neighbours = {best_area(trials).constants.K, K, next((k for k in sweep.K[1.0] if k > K), K)}
    confirming = {k: play(k, 1.0, seeds=other) for k in sorted(neighbours)}
    confirming_bins = {n: play(K, 1.0, n, other) for n in OTHER_N_BINS}
    record = describe(sweep, trials, chosen, by_exponent, by_bins)
    again = describe_confirmation(list(confirming.values()), confirming[K], confirming_bins)
    if str(record["choice"]["n_gray_bins"]) not in again["surely_better_bins"]:
        record["choice"]["n_gray_bins"] = N_BINS
    record["other_worlds"] = {"worlds": f"seeds {other[0]} to {other[-1]}", **again}
    return record


def played_settings(settings: Any) -> dict[str, Any]:
    """What all trials have in common: the settings without the constants that are swept."""
    values = settings_to_dict(settings)
    rating = {name: one for name, one in values["rating"].items() if name not in SWEPT}
    return {**values, "rating": rating}


def describe_confirmation(
    trials: list[Trial], chosen: Trial, by_bins: dict[int, Trial]
) -> dict[str, Any]:
    """What the other worlds say, as JSON values."""
    bins = {n: difference(trial.area, chosen.area) for n, trial in by_bins.items()}
    best = best_area(trials)
    return {
        "trials": [_describe_trial(trial, best) for trial in (*trials, *by_bins.values())],
        "other_bins": {str(n): _round(d) for n, d in bins.items()},
        "surely_better_bins": [str(n) for n, d in bins.items() if d.low > 0],
    }


def describe(
    sweep: Sweep,
    trials: list[Trial],
    chosen: Trial,
    by_exponent: dict[float, list[Trial]],
    by_bins: dict[int, Trial],
) -> dict[str, Any]:
    """What was tried and what follows from it, as JSON values."""
    at_motion = {
        exponent: area_at_motion(tried, float(chosen.motion.mean()))
        for exponent, tried in by_exponent.items()
    }
    exponents = {n: difference(a, chosen.area) for n, a in at_motion.items() if a is not None}
    bins = {n: difference(trial.area, chosen.area) for n, trial in by_bins.items()}
    best = best_area(trials)
    everything = [*trials, *(t for tried in by_exponent.values() for t in tried), *by_bins.values()]
    return {
        "version": __version__,
        "policy": POLICY,
        "env_kwargs": ENV_KWARGS,
        "settings": played_settings(sweep.settings),
        "worlds": f"seeds 0 to {sweep.n_worlds - 1}",
        "area": sweep.area,
        "trials": [_describe_trial(trial, best) for trial in everything],
        "other_exponents_at_equal_motion": {f"{n:g}": _round(d) for n, d in exponents.items()},
        "exponents_that_do_not_reach_this_motion": [
            f"{n:g}" for n, area in at_motion.items() if area is None
        ],
        "other_bins": {str(n): _round(d) for n, d in bins.items()},
        "choice": {
            "K": chosen.constants.K,
            "exponent": next((n for n, d in exponents.items() if d.low > 0), 1.0),
            "n_gray_bins": next((n for n, d in bins.items() if d.low > 0), N_BINS),
        },
    }


def _describe_trial(trial: Trial, best: Trial) -> dict[str, Any]:
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    c = trial.constants
    return {
        "K": c.K,
        "exponent": c.exponent,
        "n_gray_bins": c.n_gray_bins,
        "area": _round(bootstrap_mean(trial.area, rng)),
        "fraction_of_best": significant(float(trial.area.mean() / best.area.mean())),
        "less_best": _round(difference(trial.area, best.area)),
        "motion": _round(bootstrap_mean(trial.motion, rng)),
    }


def _round(interval: Any) -> list[float]:
    """Estimate, low and high end."""
    return [significant(value) for value in interval.as_dict().values()]


def main(arguments: list[str] | None = None) -> None:
    """Run the sweeps and write one record for each environment."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("out", type=Path, help="folder of the records and of finished episodes")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--env", choices=[sweep.env_name for sweep in SWEEPS], help="only this one")
    options = parser.parse_args(arguments)
    for sweep in SWEEPS:
        if options.env in (None, sweep.env_name):
            with folder_lock(options.out):
                record = run_sweep(options.out / "episodes", sweep, options.workers, log_line)
                path = options.out / f"{sweep.env_name}.json"
                write_atomically(path, json.dumps(record, indent=1) + "\n")
            log_line(f"{sweep.env_name}: {record['choice']}; record: {path}")


if __name__ == "__main__":
    with errors_as_lines("sweep"):
        main()
