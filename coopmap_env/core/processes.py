"""Processes that end together: workers with the process that started them, commands by a signal.

A command that is ended by SIGINT (Ctrl-C), SIGTERM (`kill`, batch systems, containers) or SIGHUP (a
closed terminal) raises `Interruption`, which is a KeyboardInterrupt: files and workers are cleaned
up in the same way. Workers end at once when the process that started them ends, however it ends.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import connection, resource_tracker
from types import FrameType
from typing import Any

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that ask a process to end; Windows has no SIGHUP."""


WORKER_ENDED = (
    "a worker process was killed or has ended early: finished results are kept, and the same "
    "command does the rest; if memory was short, use fewer workers"
)


class WorkerError(RuntimeError):
    """A worker process has ended before its work was done: it was killed, or memory was short."""


class Interruption(KeyboardInterrupt):
    """One of `SIGNALS` has asked this process to end."""

    def __init__(self, signum: int) -> None:
        super().__init__(signum)
        self.exit_status = exit_status(signum)
        """Of the process, by the convention of shells."""


def exit_status(signum: int) -> int:
    """Exit status of a process that a signal has ended, by the convention of shells."""
    return 128 + signum


@contextmanager
def interrupted_by_signals(notice: str) -> Iterator[None]:
    """Within the context the first of `SIGNALS` raises `Interruption`, in the main thread.

    The next one prints the notice and ends this process at once, whatever it does meanwhile.
    Signals that are ignored, as ``nohup`` does, stay so.
    """
    received: list[int] = []

    def interrupt(signum: int, _: FrameType | None) -> None:
        received.append(signum)
        if len(received) == 1:
            raise Interruption(signum)
        with suppress(OSError):
            os.write(2, f"\n{notice}\n".encode())
        os._exit(exit_status(signum))

    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # others cannot set handlers
        for signum in SIGNALS:
            if signal.getsignal(signum) != signal.SIG_IGN:
                previous[signum] = signal.signal(signum, interrupt)
    try:
        yield
    finally:
        for signum, handler in previous.items():
            signal.signal(signum, handler)


@contextmanager
def signal_handlers_kept() -> Iterator[None]:
    """Restore the handlers of `SIGNALS` that a library replaces within the context."""
    before = {signum: signal.getsignal(signum) for signum in SIGNALS}
    try:
        yield
    finally:
        if threading.current_thread() is threading.main_thread():
            for signum, handler in before.items():
                if callable(handler):
                    signal.signal(signum, handler)


@contextmanager
def signals_postponed() -> Iterator[None]:
    """Postpone `SIGNALS` to the end of the context, in which processes are started.

    So no process is left half started. A new one inherits the postponement, until it
    calls `begin_worker`: Ctrl-C, which a terminal sends to workers too, prints no traceback there.
    """
    with _handlers_postponed():
        if not hasattr(signal, "pthread_sigmask"):  # Windows
            yield
            return
        before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
        try:
            resource_tracker.ensure_running()  # with the mask, because it ignores all but SIGHUP
            signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)  # it has unblocked some
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def _handlers_postponed() -> Iterator[None]:
    """Postpone what the main thread does about signals that other threads of it receive.

    The mask of a thread is not that of the others, such as those of BLAS.
    """
    received: list[int] = []
    previous: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # others are not interrupted
        for signum in SIGNALS:
            if signal.getsignal(signum) not in (signal.SIG_IGN, None):
                previous[signum] = signal.signal(signum, lambda signum, _: received.append(signum))
    try:
        yield
    finally:
        for signum, handler in previous.items():
            signal.signal(signum, handler)
        for signum in received:
            signal.raise_signal(signum)


def begin_worker(lifeline: Any) -> None:
    """Make this process a worker: it ignores Ctrl-C, and ends when its lifeline does.

    Parameters
    ----------
    lifeline : Connection or int
        End of a pipe whose other end the main process holds: a connection, or the sentinel of
        `multiprocessing.parent_process`.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the main process handles Ctrl-C and ends us
    if hasattr(signal, "pthread_sigmask"):
        signal.pthread_sigmask(signal.SIG_UNBLOCK, SIGNALS)

    def end_with_lifeline() -> None:
        connection.wait([lifeline])
        os._exit(1)

    threading.Thread(target=end_with_lifeline, name="lifeline", daemon=True).start()


@contextmanager
def worker_pool(
    workers: int,
) -> Iterator[Callable[[Callable[[Any], Any], list[Any]], list[Any]]]:
    """Processes that work in parallel; gives a function that submits a function of each value.

    If the context is left by an exception, the workers end at once, in the middle of their work.

    Raises
    ------
    WorkerError
        If a worker has ended: it was killed, or memory was short.
    """
    # spawn: a forked child inherits locks and library threads in an undefined state
    context = multiprocessing.get_context("spawn")
    theirs, ours = context.Pipe(duplex=False)  # nobody else holds `ours`: it closes when we end
    with signals_postponed():  # its locks start the resource tracker
        pool = ProcessPoolExecutor(
            workers, mp_context=context, initializer=begin_worker, initargs=(theirs,)
        )

    def submit(function: Callable[[Any], Any], values: list[Any]) -> list[Any]:
        with signals_postponed():  # the executor starts its processes here
            return [pool.submit(function, value) for value in values]

    try:
        yield submit
        pool.shutdown()
    except BrokenProcessPool:
        raise WorkerError(WORKER_ENDED) from None
    finally:
        ours.close()
        for process in list((pool._processes or {}).values()):
            process.kill()  # those that still import, too; Python 3.14 has `kill_workers`
        pool.shutdown(cancel_futures=True)
        theirs.close()
