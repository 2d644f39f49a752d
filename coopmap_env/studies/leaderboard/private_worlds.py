"""Worlds that nobody can train on: their seeds follow from a file with random bytes, the salt.

World k of a family has the seed HMAC-SHA-256(salt, family and k), an integer of 256 bits, in the
split "test". Who does not have the salt can neither make the worlds nor guess them. A submission
has a hash of the salt, by which a wrong one is noticed.
"""

from __future__ import annotations

import hashlib
import hmac
import os
from dataclasses import dataclass

from coopmap_env.core.files import FileError, read_bytes

MIN_BYTES = 16
"""Of a salt: random bytes that nobody guesses."""
HASH_DIGITS = 16
"""Hexadecimal digits of the hash of a salt."""


@dataclass(frozen=True)
class Salt:
    """What private worlds are drawn from."""

    content: bytes

    @property
    def digest(self) -> str:
        """A hash by which the salt is recognised. It does not give the salt away."""
        return hashlib.sha256(b"coopmap salt\0" + self.content).hexdigest()[:HASH_DIGITS]

    def seed(self, family: str, world: int) -> int:
        """The seed of a world of a family."""
        message = f"coopmap private world\0{family}\0{world}".encode()
        return int.from_bytes(hmac.digest(self.content, message, "sha256"), "big")


def read_salt(path: str | os.PathLike[str]) -> Salt:
    """Read a salt: all bytes of a file as they are.

    Raises
    ------
    FileError
        If it cannot be read or has fewer than `MIN_BYTES` bytes.
    """
    content = read_bytes(path)
    if len(content) < MIN_BYTES:
        raise FileError(
            f"{path}: a salt has at least {MIN_BYTES} random bytes, got {len(content)}: make one "
            "by head -c 32 /dev/urandom > FILE"
        )
    return Salt(content)


def world_seed(salt: Salt | None, family: str, world: int) -> int:
    """Seed of a world: its number, or that of a private world."""
    return world if salt is None else salt.seed(family, world)
