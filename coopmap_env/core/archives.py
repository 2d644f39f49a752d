"""Members of ZIP archives, and gzip files, read with limits and with errors that name the file."""

from __future__ import annotations

import gzip
import io
import os
import zipfile
import zlib
from collections.abc import Iterable

from coopmap_env.core.files import FileError, read_bytes
from coopmap_env.core.limits import check_bytes

_PIECE = 4096
"""Bytes read at once: LZMA unpacks whatever a piece holds, up to 7,000 times its size."""


def read_zip_members(
    path: str | os.PathLike[str],
    names: Iterable[str],
    error_type: type[FileError] = FileError,
) -> dict[str, bytes]:
    """Contents of some members of a ZIP archive: stored, deflated or packed with LZMA.

    Their sizes together, as the archive's table of contents states them, are checked against the
    limit of `coopmap_env.core.limits` before anything is unpacked. No more than stated is unpacked.

    Raises
    ------
    error_type
        With the file, if it cannot be read (see `coopmap_env.core.files.read_bytes`), is no ZIP
        archive, lacks a member, is encrypted, broken or too large.
    """
    content = read_bytes(path, error_type)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = [_find(archive, name, path, error_type) for name in names]
            check_bytes(sum(member.file_size for member in members), "the unpacked archive")
            return {member.filename: unpack_member(archive, member) for member in members}
    except error_type:
        raise
    except Exception as error:  # zipfile raises what its decompressors and Python raise
        reason = str(error) or type(error).__name__
        raise error_type(f"{path}: not a ZIP archive that can be read: {reason:.500}") from error


def _find(
    archive: zipfile.ZipFile,
    name: str,
    path: str | os.PathLike[str],
    error_type: type[FileError],
) -> zipfile.ZipInfo:
    try:
        return archive.getinfo(name)
    except KeyError:
        raise error_type(f"{path}: has no member {name}") from None


def unpack_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Content of a member of an archive whose stated size has been checked.

    Raises
    ------
    zipfile.BadZipFile
        If it is packed with bzip2, is not of the stated size, or has another checksum. Broken data
        raise what the decompressors raise.
    """
    if member.compress_type == zipfile.ZIP_BZIP2:  # 300 bytes of it may be 300 MB, at one go
        raise zipfile.BadZipFile(f"{member.filename} is packed with bzip2: pack it with deflate")
    unpacked = bytearray()
    with archive.open(member) as file:
        while piece := file.read(_PIECE):
            unpacked += piece
    if len(unpacked) != member.file_size:
        raise zipfile.BadZipFile(
            f"{member.filename} has {len(unpacked)} bytes, not {member.file_size}"
        )
    return bytes(unpacked)


def read_gzip(path: str | os.PathLike[str], error_type: type[FileError] = FileError) -> bytes:
    """Unpacked content of a gzip file, within the limit of `coopmap_env.core.limits`.

    Raises
    ------
    error_type
        With the file, if it cannot be read (see `coopmap_env.core.files.read_bytes`), is no gzip
        file, or is broken or too large.
    """
    packed, unpacked = io.BytesIO(read_bytes(path, error_type)), bytearray()
    try:
        with gzip.GzipFile(fileobj=packed) as file:
            while piece := file.read(_PIECE):
                unpacked += piece
                check_bytes(len(unpacked), "the unpacked file")
    except (OSError, EOFError, zlib.error, ValueError) as error:
        raise error_type(f"{path}: not a gzip file that can be read: {error}") from error
    return bytes(unpacked)


def gzipped(content: bytes) -> bytes:
    """A gzip file of some content; equal contents give equal bytes with the same zlib."""
    return gzip.compress(content, mtime=0)
