"""An exception of a worker process, on its way to the main process."""

from __future__ import annotations

import pickle
import traceback
from dataclasses import dataclass

import cloudpickle  # type: ignore[import-untyped]


@dataclass(frozen=True)
class RemoteError:
    """An exception of a worker, as a message."""

    pickled: bytes
    """Empty if the exception cannot be pickled."""
    summary: str
    """Type and message."""
    report: str
    """The worker's traceback."""

    @classmethod
    def from_exception(cls, error: Exception) -> RemoteError:
        """Pack an exception."""
        try:
            pickled = cloudpickle.dumps(error)
        except Exception:  # pickling an exception's attributes may raise anything
            pickled = b""
        summary = "".join(traceback.format_exception_only(error)).strip()
        return cls(pickled, summary, "".join(traceback.format_exception(error)))

    def to_error(self, worker: str) -> Exception:
        """Unpack the exception, or make a RuntimeError; a note has the worker's traceback."""
        try:
            error = pickle.loads(self.pickled)
        except Exception:  # a constructor that does not forward `args` pickles, but fails here
            error = RuntimeError(self.summary)
        error.add_note(f"in {worker}:\n{self.report}")
        return error
