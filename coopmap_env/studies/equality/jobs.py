"""All cases of a kind, one after another or beside each other; finished ones are kept.

Worker processes import what they run by its module's name, and a package's ``__main__`` has none.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.progress import log as log_line
from coopmap_env.core.source_hash import source_hash
from coopmap_env.evaluation import Job, Result, run_jobs
from coopmap_env.studies.common.records import significant
from coopmap_env.studies.equality.cases import Case, field_cases, planar_cases
from coopmap_env.studies.equality.play import Counts, play_case
from coopmap_env.studies.equality.shown import DifferenceError

CASES: dict[str, Callable[[], Iterable[Case]]] = {"planar": planar_cases, "field": field_cases}


def play_cases(
    kind: str, n_steps: int, seed: int, folder: Path, workers: int = 1
) -> dict[str, Any]:
    """Play as many steps in all cases of a kind together, as JSON values.

    Parameters
    ----------
    kind : {"planar", "field"}
    n_steps : int
        Each case plays its part of them, rounded up to whole plays.
    seed : int
        Of worlds and actions.
    folder : Path
        Keeps finished cases. They count again as long as the package's sources are the same.
    workers : int
        Cases at a time.
    """
    cases, sources = list(CASES[kind]()), source_hash()
    goals = [n_steps * k // len(cases) for k in range(len(cases) + 1)]
    parts = [last - first for first, last in pairwise(goals)]
    jobs: list[Job] = [
        {"kind": kind, "case": k, "steps": part, "seed": seed, "sources": sources}
        for k, part in enumerate(parts)
        if part > 0
    ]
    results = run_jobs(play_job, jobs, folder, workers, is_valid=_is_result)
    total = Counts()
    for result in results:
        total += Counts.from_dict(result["counts"])
    return {
        **total.as_dict(),
        "seconds": significant(sum(result["seconds"] for result in results)),
        "cases": [
            {**cases[job["case"]].arguments, **cases[job["case"]].options,
             "steps": result["counts"]["steps"]}
            for job, result in zip(jobs, results, strict=True)
        ],
        "differences": [r["difference"] for r in results if r["difference"] is not None],
    }  # fmt: skip


def play_job(job: Job) -> Result:
    """Play one case until its first difference, if there is one."""
    case = list(CASES[job["kind"]]())[job["case"]]
    start, counts, difference = time.perf_counter(), Counts(), None
    try:
        counts = play_case(
            case, job["steps"], np.random.default_rng([job["seed"], job["case"] + 1])
        )
    except DifferenceError as error:
        difference = {"text": str(error), **error.difference._asdict()}
    seconds = time.perf_counter() - start
    log_line(f"{case}: {counts.steps:,} steps, {difference['text'] if difference else 'equal'}")
    return {"counts": counts.as_dict(), "seconds": seconds, "difference": difference}


def _is_result(value: Any) -> bool:
    """Whether a kept case is equal; what differed is played again."""
    is_whole = isinstance(value, dict) and {"counts", "seconds", "difference"} <= set(value)
    return is_whole and value["difference"] is None
