"""Errors and warnings of programs as lines for the terminal."""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from coopmap_env.core.processes import WorkerError
from coopmap_env.core.progress import log


@contextmanager
def errors_as_lines(prog: str = "coopmap") -> Iterator[None]:
    """Within the context, bad input and a failure of the machine are one line and exit status 1.

    Warnings are one line each. What is a fault of ours keeps its traceback.

    Parameters
    ----------
    prog : str
        Start of the lines.
    """

    def show(message: Any, *_: Any) -> None:
        log(f"{prog}: warning: {_joined(message)}")

    before = warnings.showwarning
    warnings.showwarning = show  # type: ignore[assignment]
    try:
        yield
    except BrokenPipeError:  # the reader of our output has ended, as `head` does
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise SystemExit(1) from None
    except (ValueError, ImportError, OSError, WorkerError) as error:
        raise SystemExit(f"{prog}: {_joined(error)}") from None
    except (MemoryError, RuntimeError) as error:
        if not _is_out_of_memory(error):
            raise
        raise SystemExit(f"{prog}: {_joined(error)}: memory is short; use fewer workers") from None
    finally:
        warnings.showwarning = before


def _joined(error: BaseException) -> str:
    """The message of an error on one line."""
    return " ".join(str(error).split()) or type(error).__name__


def _is_out_of_memory(error: BaseException) -> bool:
    """Whether memory was short; torch raises a RuntimeError."""
    return isinstance(error, MemoryError) or any(
        text in str(error) for text in ("can't allocate memory", "out of memory")
    )
