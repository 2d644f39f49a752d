"""Workers end with the process that started them; a signal ends a command in an orderly way."""

import contextlib
import os
import signal
import subprocess
import sys
import threading

import pytest

from coopmap_env.core.processes import Interruption, interrupted_by_signals, signals_postponed

JOBS_WITHOUT_END = """
import os, sys, threading
from pathlib import Path
from coopmap_env.core.processes import interrupted_by_signals
from coopmap_env.evaluation.jobs import run_jobs

def wait_for_ever(job):
    if job["n"] > 0:
        os.write(1, b"waiting\\n")  # `print` of two processes may mix lines
        threading.Event().wait()
    return {"process": os.getpid()}

if __name__ == "__main__":
    jobs = [{"n": n} for n in range(5)]
    try:
        with interrupted_by_signals("interrupted twice"):
            run_jobs(wait_for_ever, jobs, Path(sys.argv[1]), workers=2, progress=False)
    except KeyboardInterrupt as interruption:
        sys.exit(interruption.exit_status)
"""


@pytest.mark.parametrize(
    ("name", "kill"),
    [
        ("SIGINT", os.killpg),  # as a terminal does
        ("SIGTERM", os.kill),
        ("SIGHUP", os.killpg),
        ("SIGKILL", os.kill),
    ],
)
def test_no_worker_outlives_the_process_that_started_it(name, kill, tmp_path):
    script, signum = tmp_path / "jobs.py", getattr(signal, name)
    script.write_text(JOBS_WITHOUT_END)
    process = subprocess.Popen(
        [sys.executable, script, tmp_path / "results"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    for _ in range(2):
        assert process.stdout.readline() == "waiting\n"
    kill(process.pid, signum)
    # ends when the last process that can write to it has ended
    _, errors = process.communicate()
    assert "Traceback" not in errors
    assert process.returncode == (-signum if name == "SIGKILL" else 128 + signum)
    assert len(list(tmp_path.glob("results/*.json"))) <= 1
    assert not list(tmp_path.glob("results/.*.tmp.json"))


IMPORT_WITHOUT_END = """
import os, threading
if __name__ == "__mp_main__":
    os.write(1, b"importing\\n")
    threading.Event().wait()
"""


def test_a_command_that_is_ended_does_not_wait_for_the_imports_of_its_workers(tmp_path):
    script = tmp_path / "jobs.py"
    script.write_text(IMPORT_WITHOUT_END + JOBS_WITHOUT_END)
    process = subprocess.Popen(
        [sys.executable, script, tmp_path / "results"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    try:
        assert process.stdout.readline() == "importing\n"
        process.terminate()
        _, errors = process.communicate(timeout=60)
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    assert process.returncode == 128 + signal.SIGTERM
    assert "Traceback" not in errors


def raise_in_another_thread():
    signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])  # as threads of BLAS have none
    thread = threading.Thread(target=signal.raise_signal, args=[signal.SIGTERM])
    thread.start()
    thread.join()


@pytest.mark.parametrize(
    "raise_signal", [lambda: signal.raise_signal(signal.SIGTERM), raise_in_another_thread]
)
def test_a_signal_is_postponed_while_processes_are_started(raise_signal):
    steps = []

    def start_processes():
        with signals_postponed():
            raise_signal()
            steps.append("started")
        steps.append("not reached")

    with interrupted_by_signals("again"), pytest.raises(Interruption) as raised:
        start_processes()
    assert raised.value.exit_status == 128 + signal.SIGTERM
    assert steps == ["started"]


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_signal_is_an_interruption_with_the_exit_status_of_shells(signum):
    before = signal.getsignal(signum)
    with (
        pytest.raises(Interruption) as raised,
        interrupted_by_signals("again"),
    ):
        signal.raise_signal(signum)
    assert raised.value.exit_status == 128 + signum
    assert isinstance(raised.value, KeyboardInterrupt)
    assert signal.getsignal(signum) is before


def test_a_second_signal_ends_the_process_at_once_with_the_notice():
    code = """
import signal
from coopmap_env.core.processes import interrupted_by_signals
with interrupted_by_signals("finished results are kept"):
    try:
        signal.raise_signal(signal.SIGTERM)
    finally:
        signal.raise_signal(signal.SIGINT)
        print("not reached")
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 128 + signal.SIGINT
    assert done.stdout == ""
    assert done.stderr == "\nfinished results are kept\n"


def test_a_signal_that_is_ignored_stays_so():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with interrupted_by_signals("again"):
            signal.raise_signal(signal.SIGHUP)
            assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
