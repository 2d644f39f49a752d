"""Play the sweep of every family of planners on training worlds, and record the scores.

::

    make planners  # in a clone of the repository, or
    python -m coopmap_env.studies.benchmark.tuning results/planner-tuning --workers 2

The criterion, fixed before the search: for each environment, kind of actions, family and score, the
planner (motion weight and coordination) with the largest mean over the worlds of the training
split with seeds from 0; and at equal motion, the upper concave hull of mean score against mean
motion. `tuned_planners` reads the record; comparisons use other worlds, those of the test split.
After an interruption, the same command continues.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.files import write_atomically
from coopmap_env.core.locks import folder_lock
from coopmap_env.core.progress import log as log_line
from coopmap_env.core.version import __version__
from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation, compare
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.studies.benchmark.families import MOTION_WEIGHTS, SEARCH_POSES, sweep_specs
from coopmap_env.studies.benchmark.methods import (
    MOTION,
    POSE_MODE,
    STANDARD_TEAM,
    EnvKwargs,
    verdict_scores,
    with_n_candidates,
)
from coopmap_env.studies.benchmark.tuned_planners import SPLIT, default_settings
from coopmap_env.studies.common.records import significant


@dataclass(frozen=True)
class TuningCase:
    """What is to be played."""

    env_name: str
    env_kwargs: EnvKwargs
    """What the actions are: candidates, or any pose."""
    n_worlds: int
    search: int | None = None
    """Random poses of a decision, if actions are any pose."""


FULL = (
    *(TuningCase("planar", with_n_candidates(n), 48) for n in (32, 100, 300)),
    TuningCase("planar", POSE_MODE, 48, SEARCH_POSES),
    TuningCase("field", with_n_candidates(32), 12),
    TuningCase("field", POSE_MODE, 12, SEARCH_POSES),
)


def tune_planners(
    store: Path, cases: Sequence[TuningCase], workers: int, log: Callable[[str], None]
) -> dict[str, Any]:
    """Play all planners of the cases; the record as JSON values.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not played again.
    cases : sequence of TuningCase
    workers : int
        Processes; the record does not depend on it.
    log : callable
        Receives a line of progress.
    """
    return {
        "command": "python -m coopmap_env.studies.benchmark.tuning OUT",
        "version": __version__,
        "split": SPLIT,
        "first_seed": 0,
        "cases": [_tune(store, case, workers, log) for case in cases],
    }


def _tune(
    store: Path, case: TuningCase, workers: int, log: Callable[[str], None]
) -> dict[str, Any]:
    log(f"{case.env_name}, {dict(case.env_kwargs)}: {case.n_worlds} training worlds")
    specs = {
        family: list(sweep_specs(family, case.env_name, case.search))
        for family in MOTION_WEIGHTS[case.env_name]
    }
    evaluations = compare(
        [spec for family in specs.values() for spec in family],
        range(case.n_worlds),
        {**STANDARD_TEAM, **case.env_kwargs, "split": SPLIT},
        store,
        workers=workers,
        env_name=case.env_name,
    )
    scores = (*verdict_scores(case.env_name), MOTION)
    return {
        "env_name": case.env_name,
        "env_kwargs": dict(case.env_kwargs),
        "n_worlds": case.n_worlds,
        "settings": default_settings(case.env_name),
        "families": {
            family: {spec: _means(evaluations[spec], scores) for spec in members}
            for family, members in specs.items()
        },
    }


def _means(evaluation: Evaluation, scores: Sequence[str]) -> dict[str, dict[str, float]]:
    """Means with their 95 % intervals, by score."""
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return {
        score: {
            name: significant(value)
            for name, value in bootstrap_mean(evaluation.table[score], rng).as_dict().items()
        }
        for score in scores
    }


def write_record(record: dict[str, Any], path: Path) -> None:
    """Write the record with one line for each planner."""
    lines = [f'"{key}": {json.dumps(value)},' for key, value in record.items() if key != "cases"]
    cases = []
    for case in record["cases"]:
        head = {key: value for key, value in case.items() if key != "families"}
        families = ",\n".join(
            f' "{family}": {{\n'
            + ",\n".join(f"  {json.dumps(spec)}: {json.dumps(row)}" for spec, row in rows.items())
            + "}"
            for family, rows in case["families"].items()
        )
        cases.append(f'{json.dumps(head)[:-1]}, "families": {{\n{families}}}}}')
    text = "\n".join(["{", *lines, '"cases": [', ",\n".join(cases), "]}"]) + "\n"
    write_atomically(path, text)


def main(arguments: Sequence[str] | None = None) -> None:
    """The command; see the module."""
    parser = argparse.ArgumentParser(description="Tune the planners on training worlds.")
    parser.add_argument("out", type=Path, help="folder of the record and the episodes")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("--envs", default="planar,field", help="separated by commas")
    parsed = parser.parse_args(arguments)
    cases = [case for case in FULL if case.env_name in parsed.envs.split(",")]
    with folder_lock(parsed.out):
        record = tune_planners(parsed.out / "episodes", cases, parsed.workers, log_line)
        write_record(record, parsed.out / "tuned_planners.json")
    log_line(f"record: {parsed.out / 'tuned_planners.json'}")


if __name__ == "__main__":
    with errors_as_lines("tuning"):
        main()
