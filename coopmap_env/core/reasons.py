"""Reasons as integer codes, which arrays and engines can hold, and in words."""

from enum import IntEnum
from typing import Self


class Reason(IntEnum):
    """A code and its words; 0 is no reason.

    A subclass lists ``NAME = code, "words"``.
    """

    words: str
    """The reason in words; empty for none."""

    def __new__(cls, code: int, words: str = "") -> Self:
        """Make the member of a code."""
        member = int.__new__(cls, code)
        member._value_ = code
        member.words = words
        return member
