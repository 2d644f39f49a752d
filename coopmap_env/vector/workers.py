"""Blocks of worlds: one in this process, or each in a worker process of its own.

`LocalBlock` and `WorkerPool` have the same interface: `request` starts a method call in some
blocks, `replies` waits for the results. A worker serves requests until its pipe is closed by
`close`, and ends at once with the main process.

Pipes carry the names of methods and small arguments; arrays are in memory that all processes share.
It has no name and no file, so nothing is left behind when processes are killed. Messages are
pickled by cloudpickle, which also handles classes and functions that are defined in a notebook or
in a function, and read by pickle.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import pickle
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import cloudpickle  # type: ignore[import-untyped]

from coopmap_env.core.processes import WorkerError, begin_worker, signals_postponed
from coopmap_env.vector.remote_error import RemoteError
from coopmap_env.vector.step_arrays import ArrayPlan
from coopmap_env.vector.world_block import EnvFactory, WorldBlock

SHUTDOWN_TIMEOUT = 10.0
"""Seconds that a worker has to finish its step and close its environments before it is killed."""
THREAD_VARIABLES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)

Requests = Mapping[int, tuple[Any, ...]]
"""Arguments of a method, by the number of the block that calls it."""


class LocalBlock:
    """One block in this process, which does its work in `replies`."""

    def __init__(self, block: WorldBlock) -> None:
        self.block = block
        self._request: tuple[str, Requests] = ("", {})

    def request(self, method: str, arguments: Requests) -> None:
        """Store a method call for `replies`."""
        self._request = method, arguments

    def replies(self) -> dict[int, Any]:
        """Call the method, once; its result, by the number of the block."""
        method, arguments = self._request
        self._request = "", {}
        return {i: getattr(self.block, method)(*own) for i, own in arguments.items()}

    def close(self) -> None:
        """Close the environments; repeated calls do nothing."""
        self.block.close()


@dataclass(frozen=True)
class BlockSetup:
    """What a worker makes its block from."""

    factory: bytes
    """The pickled factory of environments."""
    worlds: range
    with_state: bool
    n_states: int
    plan: ArrayPlan


class WorkerPool:
    """Blocks in spawned processes, which work in parallel.

    Parameters
    ----------
    env_factory : callable
        Must be picklable by cloudpickle; each worker gets a copy.
    worlds : sequence of range
        Those of each worker.
    with_state, n_states, plan
        See `WorldBlock`.
    memory
        From `shared_memory`.
    """

    def __init__(
        self,
        env_factory: EnvFactory,
        worlds: Sequence[range],
        with_state: bool,
        n_states: int,
        plan: ArrayPlan,
        memory: Any,
    ) -> None:
        factory = cloudpickle.dumps(env_factory)
        self._workers: list[Worker] = []
        self._pending: list[int] = []
        try:
            for i, own in enumerate(worlds):
                setup = BlockSetup(factory, own, with_state, n_states, plan)
                self._workers.append(Worker(f"worker {i}", setup, memory))
            self.request("ready", dict.fromkeys(range(len(worlds)), ()))
            self.replies()
        except BaseException:
            self.kill()
            raise

    def request(self, method: str, arguments: Requests) -> None:
        """Start a method call in the workers with these numbers."""
        self._pending = list(arguments)
        with self._killed_if_interrupted():
            for i, own in arguments.items():
                self._workers[i].request(method, *own)

    def replies(self) -> dict[int, Any]:
        """Wait for all of them; results by the number of the worker.

        All replies are received before an exception is raised, so that the next replies belong to
        the next request.
        """
        pending, self._pending = self._pending, []
        replies, errors = {}, []
        with self._killed_if_interrupted():
            for i in pending:
                try:
                    replies[i] = self._workers[i].reply()
                except Exception as error:
                    errors.append(error)
        if errors:
            raise errors[0]
        return replies

    def close(self) -> None:
        """Close all environments and end the processes; repeated calls do nothing."""
        for worker in self._workers:
            worker.close_pipe()
        for worker in self._workers:
            worker.join()

    def kill(self) -> None:
        """End the processes at once: some may still import what they need."""
        for worker in self._workers:
            worker.kill()
        self.close()

    @contextlib.contextmanager
    def _killed_if_interrupted(self) -> Iterator[None]:
        """Kill after Ctrl-C: it may have interrupted a message, and the pipe is then unusable."""
        try:
            yield
        except Exception:
            raise
        except BaseException:
            self.kill()
            raise


class Worker:
    """A worker process, as the main process sees it."""

    def __init__(self, name: str, setup: BlockSetup, memory: Any) -> None:
        # spawn: a forked child would inherit locks and library threads in an undefined state
        context = multiprocessing.get_context("spawn")
        self._worlds = setup.worlds
        self._pipe, other_end = context.Pipe()
        # daemon: a main process that ends without `close` does not wait for its workers
        self._process = context.Process(
            target=run_worker, args=(other_end, setup, memory), name=name, daemon=True
        )
        self._reply_pending = False
        with signals_postponed(), _single_threaded_children():
            self._process.start()
        other_end.close()  # else the pipe would not end with the worker

    def request(self, method: str, *arguments: Any) -> None:
        """Start a method call; a reply that was not received is discarded."""
        if self._reply_pending:
            with contextlib.suppress(Exception):
                self.reply()
        message = cloudpickle.dumps((method, arguments))
        with contextlib.suppress(ConnectionError):  # `reply` reports that the worker has ended
            self._pipe.send_bytes(message)
        self._reply_pending = True

    def reply(self) -> Any:
        """Wait for the result of the method, or raise its exception.

        Raises
        ------
        WorkerError
            If the worker has ended.
        """
        try:
            message = self._pipe.recv_bytes()
        except (EOFError, ConnectionError) as error:
            self._process.join(SHUTDOWN_TIMEOUT)
            raise WorkerError(
                f"{self._process.name}, of worlds {self._worlds.start} to {self._worlds.stop - 1}, "
                f"has ended, with exit code {self._process.exitcode} (of a signal if negative; -9 "
                "often means out of memory: use fewer workers). The same command continues a "
                "training after its last segment; elsewhere, close this environment and make a new "
                "one. If the worker ended at once, the script that starts it may lack "
                "if __name__ == '__main__':"
            ) from error
        finally:
            self._reply_pending = False
        result = pickle.loads(message)
        if isinstance(result, RemoteError):
            raise result.to_error(self._process.name)
        return result

    def close_pipe(self) -> None:
        """Ask the worker to close its environments and end, after its current request."""
        self._pipe.close()

    def kill(self) -> None:
        """End the process in the middle of its work."""
        self._process.kill()

    def join(self) -> None:
        """Wait until the process has ended; kill it after `SHUTDOWN_TIMEOUT`."""
        self._process.join(SHUTDOWN_TIMEOUT)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


def shared_memory(n_bytes: int) -> Any:
    """Memory that workers share when it is an argument of their start; zeros."""
    return multiprocessing.get_context("spawn").RawArray("B", n_bytes)


def run_worker(pipe: Connection, setup: BlockSetup, memory: Any) -> None:
    """Body of a worker: make a block, and serve requests until the pipe is closed."""
    main_process = multiprocessing.parent_process()
    assert main_process is not None
    begin_worker(main_process.sentinel)
    with contextlib.suppress(EOFError, ConnectionError):
        try:
            block = WorldBlock(pickle.loads(setup.factory), setup.worlds, setup.with_state)
        except Exception as error:
            failure = cloudpickle.dumps(RemoteError.from_exception(error))
            pipe.recv_bytes()  # the first request, whatever it is
            pipe.send_bytes(failure)
            return
        with contextlib.closing(block):
            block.connect(setup.plan, memory, setup.n_states)
            while True:
                pipe.send_bytes(_handle_request(block, pipe.recv_bytes()))


def _handle_request(block: WorldBlock, request: bytes) -> bytes:
    try:
        method, arguments = pickle.loads(request)
        reply: bytes = cloudpickle.dumps(getattr(block, method)(*arguments))
    except Exception as error:
        reply = cloudpickle.dumps(RemoteError.from_exception(error))
    return reply


@contextlib.contextmanager
def _single_threaded_children() -> Iterator[None]:
    """Processes that start here have one thread each: parallel are the worlds.

    Libraries read these variables when they are imported, before a worker's own code runs.
    """
    before = {name: os.environ.get(name) for name in THREAD_VARIABLES}
    os.environ.update(dict.fromkeys(THREAD_VARIABLES, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
