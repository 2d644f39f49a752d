"""Run many independent jobs, in worker processes or on a Ray cluster; runs can be resumed.

The result of each finished job is one JSON file, written atomically and named by a hash of the job.
An interrupted or killed run finds these files and does the rest; one that cannot be used counts as
missing. Results do not depend on the order. While jobs run, the folder belongs to one process.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, wait
from itertools import islice
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, get_args

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError, read_json, write_atomically
from coopmap_env.core.locks import folder_lock
from coopmap_env.core.processes import (
    WORKER_ENDED,
    WorkerError,
    signal_handlers_kept,
    worker_pool,
)
from coopmap_env.core.progress import progress_bar

Backend = Literal["processes", "ray"]
Job = dict[str, Any]
Result = dict[str, Any]
IndexedResults = Generator[tuple[int, Result]]


def job_key(job: Job) -> str:
    """Name of a job: a hash of its JSON. Equal jobs have equal names."""
    return hashlib.sha256(json.dumps(job, sort_keys=True).encode()).hexdigest()[:24]


def run_jobs(
    function: Callable[[Job], Result],
    jobs: Sequence[Job],
    results_dir: Path,
    workers: int = 1,
    progress: bool = True,
    is_valid: Callable[[Any], bool] = lambda result: True,
    backend: Backend = "processes",
) -> list[Result]:
    """Results of all jobs, in the order of the jobs.

    Parameters
    ----------
    function : callable
        Importable; its result depends on the job alone and is JSON.
    jobs : sequence of dict
        JSON values.
    results_dir : Path
        Folder of finished results.
    workers : int
        Jobs at a time, each in a process of its own; 1 runs them in this process unless the backend
        is Ray.
    progress : bool
        Show a bar.
    is_valid : callable
        Whether a stored result can be used; the other ones count as missing.
    backend : {"processes", "ray"}
        Where jobs run: processes of this machine, or tasks of Ray; see `ray_session`.
        Results are stored by this process either way.

    Raises
    ------
    ValueError
        If `workers` is less than 1, or the backend is unknown.
    ImportError
        If the backend is Ray and it is not installed (extra ``ray``).
    OSError
        If another process runs jobs in this folder, or a result cannot be written.
    WorkerError
        If a worker was killed. As after any other error, finished results are kept.
    """
    if workers < 1:
        raise ValueError(f"workers must be at least 1, got {workers}")
    if backend not in get_args(Backend):
        raise ValueError(f"backend must be one of {get_args(Backend)}, got {backend!r}")
    run = _run_in_ray if backend == "ray" else _run_in_processes
    paths = [results_dir / f"{job_key(job)}.json" for job in jobs]
    results = [_read(path, is_valid) for path in paths]
    if None not in results:
        return _without_none(results)  # also from a folder that nobody can write to
    with folder_lock(results_dir):
        results = [_read(path, is_valid) for path in paths]  # those of the owner before, too
        missing = [(i, jobs[i]) for i, result in enumerate(results) if result is None]
        with contextlib.closing(run(function, missing, workers)) as indexed:
            n_done = len(jobs) - len(missing)
            for i, result in progress_bar(indexed, "job", len(jobs), n_done, progress):
                write_atomically(paths[i], json.dumps(result))
                results[i] = result
    return _without_none(results)


def _without_none(results: list[Result | None]) -> list[Result]:
    return [result for result in results if result is not None]


def _read(path: Path, is_valid: Callable[[Any], bool]) -> Result | None:
    """A stored result, or None if there is none that can be used."""
    try:
        value: Result = read_json(path)
    except FileError:
        return None
    return value if is_valid(value) else None


def _run_in_processes(
    function: Callable[[Job], Result], jobs: list[tuple[int, Job]], workers: int
) -> IndexedResults:
    if workers == 1 or len(jobs) < 2:
        for i, job in jobs:
            yield i, function(job)
        return
    with worker_pool(min(workers, len(jobs))) as submit:
        futures = submit(function, [job for _, job in jobs])
        running = {future: i for future, (i, _) in zip(futures, jobs, strict=True)}
        while running:
            done = wait(running, return_when=FIRST_COMPLETED).done
            # results before errors: those of the other workers are kept
            for future in sorted(done, key=lambda future: future.exception() is not None):
                yield running.pop(future), future.result()


@contextlib.contextmanager
def ray_session(workers: int) -> Iterator[ModuleType]:
    """Ray, connected for the duration of the context, quietly and without usage statistics.

    An existing connection is used and left open. Otherwise the environment variable ``RAY_ADDRESS``
    names the cluster ("auto": the one that runs on this machine). All its nodes need this package
    and the files that the jobs name. Without the variable, Ray runs on this machine alone, with
    `workers` processes.

    Raises
    ------
    ImportError
        If Ray is not installed (extra ``ray``).
    ConnectionError
        If there is no cluster at that address.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    ray = import_optional("ray", "ray")
    if ray.is_initialized():
        yield ray
        return
    cluster = os.environ.get("RAY_ADDRESS")
    with signal_handlers_kept():
        ray.init(
            address=cluster or "local",
            num_cpus=None if cluster else max(workers, 1),
            include_dashboard=False,
            logging_level=logging.ERROR,
            log_to_driver=False,
        )
    try:
        yield ray
    finally:
        ray.shutdown()


@contextlib.contextmanager
def ray_workers_checked(message: str = WORKER_ENDED) -> Iterator[None]:
    """Within the context the end of a process of Ray is a `WorkerError` with this message.

    Errors of what runs in such a process stay as they are.
    """
    exceptions = import_optional("ray", "ray").exceptions
    try:
        yield
    except exceptions.RayTaskError:
        raise
    except exceptions.RayError as error:
        raise WorkerError(f"{message} (Ray: {type(error).__name__})") from error


def _run_in_ray(
    function: Callable[[Job], Result], jobs: list[tuple[int, Job]], workers: int
) -> IndexedResults:
    if not jobs:  # Ray takes seconds to start
        return
    with ray_session(min(workers, len(jobs))) as ray, ray_workers_checked():
        task, waiting = ray.remote(function), iter(jobs)
        running: dict[Any, int] = {}
        try:
            while True:
                for i, job in islice(waiting, workers - len(running)):
                    running[task.remote(job)] = i
                if not running:
                    return
                for done in ray.wait(list(running))[0]:
                    yield running.pop(done), ray.get(done)
        finally:  # after an interruption a cluster would continue
            for remaining in running:
                ray.cancel(remaining)
