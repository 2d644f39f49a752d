import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from itertools import islice
from pathlib import Path

import pytest

from coopmap_env.core.files import write_atomically
from coopmap_env.core.locks import FolderInUseError
from coopmap_env.core.processes import WorkerError
from coopmap_env.evaluation import compare
from coopmap_env.evaluation.jobs import (
    _run_in_processes,
    _run_in_ray,
    job_key,
    ray_session,
    run_jobs,
)

JOBS = [{"n": n} for n in range(5)]


@pytest.fixture(scope="module")
def ray(tmp_path_factory):
    """Two workers of Ray; what runs jobs in it finds it connected and leaves it so."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("ray"))  # workers import from here too: no sources
        patch.setenv("PYTHONPATH", str(Path(__file__).parent))  # workers import the jobs from here
        with ray_session(workers=2) as started:
            yield started
            assert started.is_initialized()
    assert not started.is_initialized()


def square(job):
    return {"square": job["n"] ** 2, "process": os.getpid()}


def fail(job):
    raise RuntimeError(f"job {job} was run again")


def fail_at_three(job):
    if job["n"] == 3:
        raise KeyboardInterrupt
    return square(job)


def wait_for_ever(job):
    if job["n"] > 1:
        threading.Event().wait(300)
        Path(job["finished"]).touch()
    return {}


def die_at_two(job):
    if job["n"] == 2:
        os.kill(os.getpid(), signal.SIGKILL)  # as the system does if memory is short
    return square(job)


def run_again(job):
    return run_jobs(square, JOBS, Path(job["folder"]), progress=False)


def squares(results):
    return [result["square"] for result in results]


def test_results_come_in_the_order_of_the_jobs(tmp_path):
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_worker_processes_give_the_same_results_in_the_same_order(tmp_path):
    results = run_jobs(square, JOBS, tmp_path, workers=2, progress=False)
    assert squares(results) == [0, 1, 4, 9, 16]
    assert os.getpid() not in {result["process"] for result in results}


def test_finished_jobs_are_not_run_again(tmp_path):
    run_jobs(square, JOBS, tmp_path, progress=False)
    assert squares(run_jobs(fail, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_an_interrupted_run_resumes(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_jobs(fail_at_three, JOBS, tmp_path, progress=False)
    assert len(list(tmp_path.glob("*.json"))) == 3
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_a_damaged_result_is_computed_again(tmp_path):
    run_jobs(square, JOBS, tmp_path, progress=False)
    (tmp_path / f"{job_key(JOBS[2])}.json").write_text('{"squ')
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_the_progress_bar_counts_all_jobs(tmp_path, capsys):
    pytest.importorskip("tqdm")
    run_jobs(square, JOBS, tmp_path)
    assert "5/5" in capsys.readouterr().err


def test_fewer_than_one_worker_is_rejected(tmp_path):
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        run_jobs(square, JOBS, tmp_path, workers=0)


def test_a_failed_write_leaves_the_old_file_and_no_temporary_file(tmp_path):
    path = tmp_path / "file.json"
    write_atomically(path, "old")
    with pytest.raises(TypeError):
        write_atomically(path, json)  # type: ignore[arg-type]
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.json"]


def test_an_interruption_ends_the_workers_in_the_middle_of_their_jobs(tmp_path):
    finished = tmp_path / "finished"
    jobs = [(n, {"n": n, "finished": str(finished)}) for n in range(40)]
    running = _run_in_processes(wait_for_ever, jobs, workers=2)
    list(islice(running, 2))
    running.close()  # as an exception in the loop over it does
    assert multiprocessing.active_children() == []
    assert not finished.exists()


def test_a_killed_worker_is_one_error_and_finished_results_are_kept(tmp_path):
    with pytest.raises(WorkerError, match=r"the same command does the rest; .* fewer workers"):
        run_jobs(die_at_two, JOBS, tmp_path, workers=2, progress=False)
    kept = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert 1 <= len(kept) <= 4  # that worker had finished a job, and nobody can finish its last one
    assert f"{job_key(JOBS[2])}.json" not in kept
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]
    assert all((tmp_path / name).read_bytes() == content for name, content in kept.items())


def test_a_folder_has_one_run_at_a_time(tmp_path):
    with pytest.raises(FolderInUseError, match=f"{tmp_path} is in use by"):
        run_jobs(run_again, [{"folder": str(tmp_path)}], tmp_path, progress=False)
    assert list(tmp_path.iterdir()) == []


def test_finished_results_are_read_from_a_folder_that_cannot_be_written_to(tmp_path, monkeypatch):
    def refuse(folder):
        raise PermissionError(folder)

    run_jobs(square, JOBS, tmp_path, progress=False)
    monkeypatch.setattr("coopmap_env.evaluation.jobs.folder_lock", refuse)
    assert squares(run_jobs(fail, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]
    with pytest.raises(PermissionError):
        run_jobs(square, [*JOBS, {"n": 5}], tmp_path, progress=False)


def test_an_invalid_stored_result_is_computed_again(tmp_path):
    run_jobs(square, JOBS, tmp_path, progress=False)
    (tmp_path / f"{job_key(JOBS[2])}.json").write_text("{}")
    results = run_jobs(square, JOBS, tmp_path, progress=False, is_valid=lambda result: bool(result))
    assert squares(results) == [0, 1, 4, 9, 16]


@pytest.mark.usefixtures("ray")
def test_ray_s_workers_give_the_same_results_and_files_as_this_process(tmp_path):
    run_jobs(square, JOBS, tmp_path / "here", progress=False)
    results = run_jobs(square, JOBS, tmp_path / "ray", 2, progress=False, backend="ray")
    assert squares(results) == [0, 1, 4, 9, 16]
    assert os.getpid() not in {result["process"] for result in results}
    here, there = ({path.name for path in tmp_path.glob(f"{of}/*")} for of in ("here", "ray"))
    assert here == there


def test_finished_ray_jobs_are_run_again_by_neither_backend(tmp_path, ray):
    run_jobs(square, JOBS[:3], tmp_path, 2, progress=False, backend="ray")
    assert squares(run_jobs(fail, JOBS[:3], tmp_path, progress=False)) == [0, 1, 4]
    assert squares(run_jobs(square, JOBS, tmp_path, 2, progress=False, backend="ray"))[4] == 16
    results = run_jobs(fail, JOBS, tmp_path, 2, progress=False, backend="ray")
    assert squares(results) == [0, 1, 4, 9, 16]


def test_an_error_in_a_ray_worker_is_raised_here_and_finished_results_stay(tmp_path, ray):
    run_jobs(square, JOBS[:2], tmp_path, 1, progress=False, backend="ray")
    with pytest.raises(RuntimeError, match=r"job \{'n': 2\} was run again"):
        run_jobs(fail, JOBS, tmp_path, 1, progress=False, backend="ray")
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.usefixtures("ray")
def test_a_worker_of_ray_that_is_killed_again_and_again_is_one_error(tmp_path):
    with pytest.raises(WorkerError, match=r"the same command does the rest.*Ray: WorkerCrashed"):
        run_jobs(die_at_two, JOBS[1:3], tmp_path, 1, progress=False, backend="ray")
    assert [path.name for path in tmp_path.iterdir()] == [f"{job_key(JOBS[1])}.json"]


class CountedJobs(list):
    """Jobs that count how many of them were handed out."""

    n_given = 0

    def __iter__(self):
        for job in super().__iter__():
            self.n_given += 1
            yield job


@pytest.mark.usefixtures("ray")
def test_ray_is_given_as_many_jobs_at_a_time_as_there_are_workers():
    jobs = CountedJobs((n, {"n": n}) for n in range(40))
    running = _run_in_ray(square, jobs, workers=2)
    for n_finished in range(3):
        next(running)
        assert jobs.n_given == 2 + n_finished
    running.close()  # as an exception in the loop over it does
    assert jobs.n_given == 4


@pytest.mark.usefixtures("ray")
def test_episodes_do_not_depend_on_the_backend(tmp_path):
    policies, arguments = ["rating_function:search=10", "raster"], {"max_scans": 3, "split": "test"}
    here = compare(policies, [4], arguments, tmp_path / "here", progress=False)
    there = compare(policies, [4], arguments, tmp_path / "ray", None, 2, False, backend="ray")
    for name in policies:
        one, two = (
            replace(result[name].episodes[0], planning_time_ms=0.0) for result in (here, there)
        )
        assert one == two


def test_the_environment_names_the_cluster_of_ray(ray):
    code = """
from coopmap_env.evaluation import ray_session
with ray_session(1) as ray:
    print(ray.get_runtime_context().gcs_address)
"""
    address = ray.get_runtime_context().gcs_address
    environment = {**os.environ, "RAY_ADDRESS": address}
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True
    )
    assert run.stdout.strip() == address
    assert run.stderr == ""


def test_an_unknown_backend_is_rejected(tmp_path):
    with pytest.raises(ValueError, match=r"backend must be one of .*'ray'.*, got 'dask'"):
        run_jobs(square, JOBS, tmp_path, backend="dask")


def test_a_missing_ray_is_named_with_the_command_that_brings_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ImportError, match=r"ray is needed here.*pip install 'coopmap\[ray\]'"):
        run_jobs(square, JOBS, tmp_path, progress=False, backend="ray")
