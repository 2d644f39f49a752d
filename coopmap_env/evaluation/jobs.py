"""Many independent jobs: in worker processes, resumable, the same results in any order.

Each finished job is one JSON file, written at once (a temporary file, then renamed), named by a
hash of what the job is. A run that was interrupted finds them and does the rest.
"""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import tempfile
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from pathlib import Path
from typing import Any

from coopmap_env.extras import require

Job = dict[str, Any]
Result = dict[str, Any]


def write_atomically(path: Path, text: str) -> None:
    """Write a file so that it is there whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=path.name, suffix=".tmp")
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as file:
            file.write(text)
        os.chmod(temporary, 0o644)  # mkstemp's own mode would lock out everybody else
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def job_key(job: Job) -> str:
    """Name of a job: a hash of its JSON, so equal jobs have equal names."""
    return hashlib.sha256(json.dumps(job, sort_keys=True).encode()).hexdigest()[:24]


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    store: Path,
    workers: int = 1,
    progress: bool = True,
    usable: Callable[[Any], bool] = lambda result: True,
) -> list[Result]:
    """Results of all jobs, in the order of the jobs.

    Parameters
    ----------
    function : callable
        Importable, and a function of its job alone; its result is JSON.
    jobs : sequence of dict
        JSON values.
    store : Path
        Folder of finished results.
    workers : int
        Processes; 1 works in this one.
    progress : bool
        Show a bar (extra ``cli``).
    usable : callable
        Whether a stored result can be used; others count as missing.

    Raises
    ------
    ValueError
        If `workers` is less than 1.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    store.mkdir(parents=True, exist_ok=True)
    paths = [store / f"{job_key(job)}.json" for job in jobs]
    results = [_read(path, usable) for path in paths]
    missing = [i for i, result in enumerate(results) if result is None]
    for i, result in _bar(
        _run(function, [(i, jobs[i]) for i in missing], workers), len(jobs), len(missing), progress
    ):
        write_atomically(paths[i], json.dumps(result))
        results[i] = result
    return [result for result in results if result is not None]


def _read(path: Path, usable: Callable[[Any], bool]) -> Result | None:
    """A stored result, or None if there is none that can be read."""
    try:
        value: Result = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, json.JSONDecodeError):
        return None
    return value if usable(value) else None


def _run(
    function: Callable[[Job], Result], jobs: list[tuple[int, Job]], workers: int
) -> Iterator[tuple[int, Result]]:
    if workers == 1 or len(jobs) < 2:
        for i, job in jobs:
            yield i, function(job)
        return
    # spawn: a forked child would inherit locks and library threads in an undefined state
    context = multiprocessing.get_context("spawn")
    pool = ProcessPoolExecutor(min(workers, len(jobs)), mp_context=context)
    try:
        futures: dict[Future[Result], int] = {pool.submit(function, job): i for i, job in jobs}
        while futures:
            for future in wait(futures, return_when=FIRST_COMPLETED).done:
                yield futures.pop(future), future.result()
    finally:  # an interruption leaves at most the jobs that run already
        pool.shutdown(wait=True, cancel_futures=True)


def _bar(
    results: Iterable[tuple[int, Result]], total: int, missing: int, progress: bool
) -> Iterable[tuple[int, Result]]:
    if not progress:
        return results
    tqdm = require("tqdm", "cli").tqdm
    bar: Iterable[tuple[int, Result]] = tqdm(
        results, total=total, initial=total - missing, unit="job", smoothing=0.1
    )
    return bar
