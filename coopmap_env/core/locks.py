"""Folders of results belong to one process at a time."""

from __future__ import annotations

import json
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

from filelock import FileLock, Timeout

from coopmap_env.core.files import (
    FileError,
    brief,
    read_json,
    remove_temporary_files,
    write_atomically,
)

LOCK_FILE = ".coopmap.lock"
OWNER_FILE = ".coopmap.owner"
"""Process, machine and start of the owner, for the message to others."""


class FolderInUseError(OSError):
    """Another process, or another thread of this one, writes into the folder."""


@contextmanager
def folder_lock(folder: str | os.PathLike[str]) -> Iterator[None]:
    """Own a folder within the context; it is made if it is missing, and removed if left empty.

    The operating system releases the lock when the process ends, however it ends. A killed process
    leaves two small hidden files, `LOCK_FILE` and `OWNER_FILE`, and perhaps a file that it was
    writing; the next owner removes them.

    Raises
    ------
    FolderInUseError
        At once, with the owner, if the folder has another one.
    OSError
        If the folder cannot be made or written to.
    """
    folder = Path(folder)
    is_new = not folder.exists()
    lock_file, owner_file = folder / LOCK_FILE, folder / OWNER_FILE
    lock = FileLock(lock_file, timeout=0, thread_local=False)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout:
        raise FolderInUseError(
            f"{folder} is in use by {_read_owner(owner_file)}: wait until it has finished, end it, "
            "or use another folder"
        ) from None
    except OSError as error:
        raise OSError(
            f"{folder} cannot be used as a folder of results: {error.strerror or error}"
        ) from error
    try:
        remove_temporary_files(folder)
        write_atomically(owner_file, json.dumps(_this_process()))
        yield
    finally:
        with suppress(OSError):
            owner_file.unlink(missing_ok=True)
            if os.name == "posix":  # whoever waits for it checks that the file is still there
                lock_file.unlink(missing_ok=True)
        lock.release()
        if is_new:
            with suppress(OSError):  # it is not empty
                folder.rmdir()


def _this_process() -> dict[str, object]:
    return {
        "process": os.getpid(),
        "machine": socket.gethostname(),
        "since": datetime.now(UTC).isoformat(" ", "seconds"),
    }


def _read_owner(path: Path) -> str:
    """Who owns the folder, in words."""
    try:
        owner = read_json(path)
        process, machine, since = (owner[key] for key in ("process", "machine", "since"))
    except (FileError, TypeError, KeyError):  # it begins or ends at this moment
        return "another process"
    if process == os.getpid() and machine == socket.gethostname():
        return f"another thread of this process, since {brief(since)}"
    return f"process {brief(process)} on {brief(machine)}, since {brief(since)}"
