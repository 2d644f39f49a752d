"""A hash of the sources: results that are kept count as long as no module has changed."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

HASH_DIGITS = 16


@cache
def source_hash() -> str:
    """Hash of all modules of `coopmap_env` as they are at the first call, hexadecimal digits."""
    folder, sha = Path(__file__).parents[1], hashlib.sha256()
    for path in sorted(folder.rglob("*.py")):
        content = path.read_bytes()
        sha.update(f"{path.relative_to(folder).as_posix()} {len(content)}\0".encode() + content)
    return sha.hexdigest()[:HASH_DIGITS]
