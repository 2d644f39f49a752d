"""Blocks of environments: one in this process, or each in a worker process of its own.

Both sides of a pipe. `LocalBlock` and `WorkerPool` are asked in the same way: `request` says what each
block is to do, `replies` waits for what they return. A worker answers until the pipe ends, be it
because it was closed or because the main process is gone; so no worker outlives the main process.

What goes through a pipe is pickled by cloudpickle, which also takes what is defined in a notebook
or a function. What it writes, pickle reads: workers need neither Stable-Baselines3 nor torch.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import cloudpickle  # type: ignore[import-untyped]
from coopmap_agents.rollouts.team_block import EnvFactory, TeamBlock

SHUTDOWN_TIMEOUT = 10.0
"""Seconds in which a worker has to end its step and close its environments, before it is killed."""

Requests = Mapping[int, tuple[Any, ...]]
"""Arguments of a method, by the number of the block that is to call it."""


class LocalBlock:
    """One block in this process, which does its work when the reply is awaited."""

    def __init__(self, env_factory: EnvFactory, n_envs: int, with_state: bool) -> None:
        self._block = TeamBlock(env_factory, n_envs, with_state)
        self._request: tuple[str, Requests] = ("", {})
        self.closed = False

    def request(self, method: str, arguments: Requests) -> None:
        """Keep for `replies` what the block is to do."""
        self._request = method, arguments

    def replies(self) -> dict[int, Any]:
        """Do it, once; what the method returned, under the block's number."""
        method, arguments = self._request
        self._request = "", {}
        return {i: getattr(self._block, method)(*own) for i, own in arguments.items()}

    def close(self) -> None:
        """Close the environments, once."""
        self.closed = True
        self._block.close()


class WorkerPool:
    """Blocks in spawned processes, which work at the same time.

    Parameters
    ----------
    env_factory : callable
        Can be pickled by cloudpickle; each worker gets its own copy.
    shares : sequence of int
        Number of environments of each worker.
    with_state : bool
    """

    def __init__(
        self, env_factory: EnvFactory, envs_per_worker: Sequence[int], with_state: bool
    ) -> None:
        factory = cloudpickle.dumps(env_factory)
        self._workers: list[Worker] = []
        self._pending: list[int] = []
        self.closed = False
        try:
            for i, n_envs in enumerate(envs_per_worker):
                self._workers.append(Worker(f"worker {i}", factory, n_envs, with_state))
        except BaseException:
            self.close()
            raise

    def request(self, method: str, arguments: Requests) -> None:
        """Let the workers with these numbers begin."""
        self._pending = list(arguments)
        with self._closed_if_interrupted():
            for i, own in arguments.items():
                self._workers[i].request(method, *own)

    def replies(self) -> dict[int, Any]:
        """Wait for all of them; what the method returned, by the number of the worker.

        All are heard before an exception is raised, so that the next replies are to the next
        request.
        """
        pending, self._pending = self._pending, []
        replies, errors = {}, []
        with self._closed_if_interrupted():
            for i in pending:
                try:
                    replies[i] = self._workers[i].reply()
                except Exception as error:
                    errors.append(error)
        if errors:
            raise errors[0]
        return replies

    def close(self) -> None:
        """Close all environments and end the processes, once."""
        self.closed = True
        for worker in self._workers:
            worker.close_pipe()
        for worker in self._workers:
            worker.join()

    @contextlib.contextmanager
    def _closed_if_interrupted(self) -> Iterator[None]:
        """Ctrl-C may come in the middle of a message: what follows it could not be understood."""
        try:
            yield
        except Exception:
            raise
        except BaseException:
            self.close()
            raise


class Worker:
    """The main process's end of a worker."""

    def __init__(self, name: str, factory: bytes, n_envs: int, with_state: bool) -> None:
        # spawn: a forked child would inherit locks and library threads in an undefined state
        context = multiprocessing.get_context("spawn")
        self._pipe, other_end = context.Pipe()
        # daemon: if the main process ends without `close`, it does not wait for its workers
        self._process = context.Process(
            target=run_worker, args=(other_end, factory, n_envs, with_state), name=name, daemon=True
        )
        self._reply_pending = False
        self._process.start()
        other_end.close()  # else the pipe would not end with the worker

    def request(self, method: str, *arguments: Any) -> None:
        """Begin; a reply that nobody has waited for is dropped."""
        if self._reply_pending:
            with contextlib.suppress(Exception):
                self.reply()
        message = cloudpickle.dumps((method, arguments))
        with contextlib.suppress(ConnectionError):  # `reply` tells that the worker has ended
            self._pipe.send_bytes(message)
        self._reply_pending = True

    def reply(self) -> Any:
        """Wait for what the method returned, or raise what it raised.

        Raises
        ------
        RuntimeError
            If the worker has ended.
        """
        try:
            message = self._pipe.recv_bytes()
        except (EOFError, ConnectionError) as error:
            self._process.join(SHUTDOWN_TIMEOUT)
            raise RuntimeError(
                f"{self._process.name} has ended, with exit code {self._process.exitcode} (of "
                "a signal if negative; -9 often means out of memory): close this environment and "
                "make a new one. If it ended at once, the script that starts workers may lack "
                "if __name__ == '__main__':"
            ) from error
        finally:
            self._reply_pending = False
        result = pickle.loads(message)
        if isinstance(result, RemoteError):
            raise result.to_error(self._process.name)
        return result

    def close_pipe(self) -> None:
        """Let the worker close its environments and end, after what it is doing."""
        self._pipe.close()

    def join(self) -> None:
        """Wait until the process has ended, and end it if that takes too long."""
        self._process.join(SHUTDOWN_TIMEOUT)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()


@dataclass(frozen=True)
class RemoteError:
    """An exception on its way out of a worker."""

    pickled: bytes
    """Empty if the exception cannot be pickled."""
    summary: str
    """Type and message."""
    report: str
    """Traceback in the worker."""

    @classmethod
    def from_exception(cls, error: Exception) -> RemoteError:
        """Pack what was raised."""
        try:
            pickled = cloudpickle.dumps(error)
        except Exception:  # whatever an exception's attributes raise when they are pickled
            pickled = b""
        summary = "".join(traceback.format_exception_only(error)).strip()
        return cls(pickled, summary, "".join(traceback.format_exception(error)))

    def to_error(self, worker: str) -> Exception:
        """Unpack it, or a RuntimeError in its place; the worker's traceback is a note."""
        try:
            error = pickle.loads(self.pickled)
        except Exception:  # exceptions that do not pass `args` on pickle, but do not unpickle
            error = RuntimeError(self.summary)
        error.add_note(f"in {worker}:\n{self.report}")
        return error


def run_worker(pipe: Connection, factory: bytes, n_envs: int, with_state: bool) -> None:
    """Be a worker: make a block and do what the pipe asks for, until it ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the main process, which closes us
    with contextlib.suppress(EOFError, ConnectionError):
        try:
            block = TeamBlock(pickle.loads(factory), n_envs, with_state)
        except Exception as error:
            failure = cloudpickle.dumps(RemoteError.from_exception(error))
            pipe.recv_bytes()  # whatever is asked first
            pipe.send_bytes(failure)
            return
        with contextlib.closing(block):
            while True:
                pipe.send_bytes(_handle_request(block, pipe.recv_bytes()))


def _handle_request(block: TeamBlock, request: bytes) -> bytes:
    try:
        method, arguments = pickle.loads(request)
        reply: bytes = cloudpickle.dumps(getattr(block, method)(*arguments))
    except Exception as error:
        reply = cloudpickle.dumps(RemoteError.from_exception(error))
    return reply
