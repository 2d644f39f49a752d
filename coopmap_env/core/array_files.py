"""NumPy's archives of arrays (``.npz``): written whole or not at all, read without running code."""

from __future__ import annotations

import io
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import read_zip_members
from coopmap_env.core.files import FileError, brief, write_atomically

MAX_TEXT_BYTES = 1 << 16
"""Of an array that is a text."""
_HEADER_READERS = {
    (1, 0): np.lib.format.read_array_header_1_0,
    (2, 0): np.lib.format.read_array_header_2_0,
}


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, NDArray[Any]]) -> None:
    """Write an archive, compressed."""
    buffer, members = io.BytesIO(), dict[str, Any](arrays)
    np.savez_compressed(buffer, **members)
    write_atomically(path, buffer.getvalue())


def read_arrays(
    path: str | os.PathLike[str],
    names: Sequence[str],
    error_type: type[FileError] = FileError,
) -> dict[str, NDArray[Any]]:
    """Some arrays of an archive, by name.

    Raises
    ------
    error_type
        If the file is missing, broken or too large, or lacks one of them.
    """
    contents = read_zip_members(path, [f"{name}.npy" for name in names], error_type)
    return {
        name.removesuffix(".npy"): _parse_array(path, name, content, error_type)
        for name, content in contents.items()
    }


def read_texts(
    path: str | os.PathLike[str],
    names: Sequence[str],
    error_type: type[FileError] = FileError,
) -> list[str]:
    """Some texts of an archive, which are arrays without axes.

    Raises
    ------
    error_type
        As `read_arrays`, and if one of them is no text or too long.
    """
    entries = read_arrays(path, names, error_type)
    return [_text(path, name, entries[name], error_type) for name in names]


def _parse_array(
    path: str | os.PathLike[str], name: str, content: bytes, error_type: type[FileError]
) -> NDArray[Any]:
    """The array of an NPY file, whose header must state exactly the bytes that follow it."""
    file = io.BytesIO(content)
    try:
        version = np.lib.format.read_magic(file)
        shape, column_major, dtype = _HEADER_READERS[version](file)
        data = content[file.tell() :]
        if dtype.hasobject or math.prod(shape) * dtype.itemsize != len(data):
            raise ValueError(f"{len(data)} bytes are no {brief(dtype)} of shape {brief(shape)}")
        return np.ndarray(shape, dtype, data, order="F" if column_major else "C")
    except Exception as error:  # a header is Python's text, and is read with what reads Python
        raise error_type(f"{path}: {name} is broken: {error!r:.500}") from error


def _text(
    path: str | os.PathLike[str], name: str, entry: NDArray[Any], error_type: type[FileError]
) -> str:
    try:
        if entry.ndim or entry.dtype.kind != "U" or entry.nbytes > MAX_TEXT_BYTES:
            raise ValueError(f"expected a text of at most {MAX_TEXT_BYTES} bytes")
        return str(entry)
    except ValueError as error:  # also of a number that is no character
        raise error_type(f"{path}: {name}.npy is broken: {error}") from error
