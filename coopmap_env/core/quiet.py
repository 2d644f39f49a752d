"""Silence of C libraries that print at their start what no user asked for."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def native_stderr_muted() -> Iterator[None]:
    """Within the context, what is printed to the standard error stream of the process is dropped.

    Errors of Python are raised as ever.
    """
    try:
        kept = os.dup(2)
    except OSError:  # there is no such stream
        yield
        return
    with suppress(AttributeError, ValueError, OSError):  # none of Python's own, or a closed one
        sys.stderr.flush()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)
