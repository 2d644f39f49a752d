"""Files: written whole or not at all; read with limits, and with errors that name the file.

YAML and XML are read by `yaml_files` and `xml_files`, ZIP archives by `archives`.
"""

from __future__ import annotations

import json
import os
import re
import reprlib
import stat
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from coopmap_env.core.limits import check_bytes


class FileError(ValueError):
    """A file that is missing, broken, too large or of another form; the message names it.

    Every reader of files raises this error or one that inherits from it.
    """


@contextmanager
def atomic_path(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Temporary path beside `path`, with the same suffix; moved to `path` when the block ends.

    After an error the temporary file is removed and `path` is as it was.
    """
    target = Path(path)
    temporary = target.with_name(f".{target.stem}.{uuid.uuid4().hex}.tmp{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def remove_temporary_files(folder: Path) -> None:
    """Remove what processes that were killed while they wrote into a folder have left there."""
    for path in folder.glob(".*.tmp*"):
        if re.fullmatch(r"\..*\.[0-9a-f]{32}\.tmp(\..*)?", path.name):
            path.unlink(missing_ok=True)


def write_atomically(path: str | os.PathLike[str], content: str | bytes) -> None:
    """Write text (UTF-8) or bytes to a file; missing folders are made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        temporary.write_bytes(content.encode() if isinstance(content, str) else content)


def read_bytes(path: str | os.PathLike[str], error_type: type[FileError] = FileError) -> bytes:
    """Content of a regular file within the limit of `coopmap_env.core.limits`.

    Raises
    ------
    error_type
        With the file, if it is missing, no regular file, too large or cannot be read.
    """
    try:
        with open(path, "rb", opener=_open_without_waiting) as file:
            status = os.fstat(file.fileno())
            if not stat.S_ISREG(status.st_mode):
                raise error_type(f"{path} is no regular file")
            try:
                check_bytes(status.st_size, "the file")
            except ValueError as error:
                raise error_type(f"{path}: {error}") from error
            return file.read(status.st_size)
    except FileNotFoundError as error:
        raise error_type(f"{path}: there is no such file") from error
    except (OSError, ValueError, MemoryError) as error:  # ValueError: a path with a null byte
        if isinstance(error, error_type):
            raise
        raise error_type(f"{path} cannot be read: {error}") from error


def _open_without_waiting(path: str, flags: int) -> int:
    """A file descriptor; a pipe without a writer would make `open` wait."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def read_text(path: str | os.PathLike[str], error_type: type[FileError] = FileError) -> str:
    """Content of a file of UTF-8 text; see `read_bytes`.

    Raises
    ------
    error_type
        Also if it is not UTF-8.
    """
    try:
        return read_bytes(path, error_type).decode()
    except UnicodeDecodeError as error:
        raise error_type(f"{path}: expected UTF-8 text: {error}") from error


def read_json(path: str | os.PathLike[str], error_type: type[FileError] = FileError) -> Any:
    """The value of a JSON file; see `read_text`.

    Raises
    ------
    error_type
        Also if it is not JSON.
    """
    try:
        return json.loads(read_text(path, error_type))
    except (ValueError, RecursionError) as error:  # ValueError: also a number of too many digits
        if isinstance(error, error_type):
            raise
        raise error_type(f"{path}: expected JSON: {error}") from error


def brief(value: object) -> str:
    """Representation of a value from a file, cut to about a line however large it is."""
    shorter = reprlib.Repr()
    shorter.maxlevel, shorter.maxstring, shorter.maxother = 3, 60, 100
    try:
        return re.sub(r"\n\s*", " ", shorter.repr(value))[:200]
    except Exception:  # what has no representation, such as an integer of over 4,300 digits
        return f"<{type(value).__name__}>"


def private_folder() -> Path:
    """Folder for temporary files of this user, which nobody else can write to.

    Raises
    ------
    FileError
        If a link, a file, or a folder that others own or can write to stands in its place.
    """
    user = getattr(os, "getuid", lambda: 0)()
    folder = Path(tempfile.gettempdir()) / f"coopmap-{user}"
    with suppress(FileExistsError):
        folder.mkdir(mode=0o700, parents=True)
    status = folder.lstat()
    if os.name != "posix":  # elsewhere the folder for temporary files is the user's own
        return folder
    if not stat.S_ISDIR(status.st_mode) or status.st_uid != user or status.st_mode & 0o077:
        raise FileError(
            f"{folder} must be a folder that is yours alone (mode 0700): remove it, "
            "or name another folder for temporary files by TMPDIR"
        )
    return folder
