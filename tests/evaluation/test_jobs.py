import json
import os
import time
from itertools import islice
from pathlib import Path

import pytest

from coopmap_env.evaluation.jobs import _run, job_key, run_jobs, write_atomically

JOBS = [{"n": n} for n in range(5)]


def square(job):
    return {"square": job["n"] ** 2, "process": os.getpid()}


def refuse(job):
    raise RuntimeError(f"job {job} was run again")


def fail_at_three(job):
    if job["n"] == 3:
        raise KeyboardInterrupt
    return square(job)


def slow(job):
    (Path(job["folder"]) / str(job["n"])).touch()
    time.sleep(0.3)
    return {}


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
    assert squares(run_jobs(refuse, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_an_interrupted_run_goes_on_where_it_was(tmp_path):
    with pytest.raises(KeyboardInterrupt):
        run_jobs(fail_at_three, JOBS, tmp_path, progress=False)
    assert len(list(tmp_path.glob("*.json"))) == 3
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_a_damaged_result_is_made_again(tmp_path):
    run_jobs(square, JOBS, tmp_path, progress=False)
    (tmp_path / f"{job_key(JOBS[2])}.json").write_text('{"squ')
    assert squares(run_jobs(square, JOBS, tmp_path, progress=False)) == [0, 1, 4, 9, 16]


def test_the_progress_bar_counts_all_jobs(tmp_path, capsys):
    pytest.importorskip("tqdm")
    run_jobs(square, JOBS, tmp_path)
    assert "5/5" in capsys.readouterr().err


def test_fewer_than_one_worker_is_refused(tmp_path):
    with pytest.raises(ValueError, match="workers must be at least 1, got 0"):
        run_jobs(square, JOBS, tmp_path, workers=0)


def test_a_failed_write_leaves_the_old_file_and_no_litter(tmp_path):
    path = tmp_path / "file.json"
    write_atomically(path, "old")
    with pytest.raises(TypeError):
        write_atomically(path, json)  # type: ignore[arg-type]
    assert path.read_text() == "old"
    assert [entry.name for entry in tmp_path.iterdir()] == ["file.json"]


def test_an_interruption_stops_the_workers_too(tmp_path):
    jobs = [(n, {"n": n, "folder": str(tmp_path)}) for n in range(40)]
    running = _run(slow, jobs, workers=2)
    list(islice(running, 2))
    running.close()  # as an exception in the loop over it does
    begun = len(list(tmp_path.iterdir()))
    time.sleep(0.7)
    assert len(list(tmp_path.iterdir())) == begun < 12


def test_a_stored_result_of_no_use_is_made_again(tmp_path):
    run_jobs(square, JOBS, tmp_path, progress=False)
    (tmp_path / f"{job_key(JOBS[2])}.json").write_text("{}")
    results = run_jobs(square, JOBS, tmp_path, progress=False, usable=lambda result: bool(result))
    assert squares(results) == [0, 1, 4, 9, 16]
