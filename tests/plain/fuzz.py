"""Broken files and values for fuzz tests: mutations of good ones, drawn from a seed."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
WORD = re.compile(rb"[A-Za-z_]{2,}")
EXTREME_NUMBERS = (
    b"0", b"-1", b"1", b"nan", b"inf", b"-inf", b"1e308", b"-1e-308", b"2147483648", b"1,5",
    b"99999999999999999999", b"0x10", b"1e999", b"", b"null", b"[]", b"{}", b"true", b"'a'",
)  # fmt: skip
SPECIAL_BYTES = (b"\x00", b"\xff", b"\n", b"\r\n", b" ", b"\t", b"<", b">", b"&", b"*", b":", b'"')
MAX_MUTATIONS = 3


def cases(short: int, long: int):
    """Decorator of a fuzz test with the argument `n_cases`: a short run, and a long one by marker.

    `short` is chosen so that the run lasts some seconds, 30 at most.
    """
    return pytest.mark.parametrize(
        "n_cases",
        [
            pytest.param(short, id="short"),
            pytest.param(long, id="long", marks=pytest.mark.long),
        ],
    )


def mutants(originals: list[bytes], n_cases: int, seed: int = 0) -> Iterator[bytes]:
    """Contents of broken files: each an original with one to `MAX_MUTATIONS` mutations."""
    rng = np.random.default_rng(seed)
    for _ in range(n_cases):
        content = originals[rng.integers(len(originals))]
        for _ in range(rng.integers(1, MAX_MUTATIONS + 1)):
            mutation = MUTATIONS[rng.integers(len(MUTATIONS))]
            content = mutation(content, rng)
        yield content


def read_or_refuse(
    read: Callable[[Path], Any], path: Path, error_type: type[Exception], start: str = ""
) -> Any:
    """What is read from a broken file, or None if it is refused as it must be.

    That is by this error alone, whose message begins with the path, after `start`, and is short.
    """
    try:
        return read(path)
    except error_type as error:
        message = str(error)
    assert message.startswith(f"{start}{path}"), message
    assert len(message) < 1500 + 10 * len(str(path)), message
    return None


def _truncate(content, rng):
    return content[: rng.integers(len(content) + 1)]


def _change_bytes(content, rng):
    changed = bytearray(content)
    for _ in range(rng.integers(1, 9)):
        if changed:
            changed[rng.integers(len(changed))] = rng.integers(256)
    return bytes(changed)


def _span(content, rng):
    start, stop = sorted(rng.integers(len(content) + 1, size=2))
    return start, min(stop, start + rng.integers(1, 200))


def _remove(content, rng):
    start, stop = _span(content, rng)
    return content[:start] + content[stop:]


def _repeat(content, rng):
    start, stop = _span(content, rng)
    return content[:stop] + content[start:stop] * rng.integers(1, 20) + content[stop:]


def _insert(content, rng):
    at = rng.integers(len(content) + 1)
    return content[:at] + SPECIAL_BYTES[rng.integers(len(SPECIAL_BYTES))] + content[at:]


def _replace_match(content, rng, pattern, replacement):
    found = list(pattern.finditer(content))
    if not found:
        return content
    match = found[rng.integers(len(found))]
    return content[: match.start()] + replacement + content[match.end() :]


def _change_number(content, rng):
    extreme = EXTREME_NUMBERS[rng.integers(len(EXTREME_NUMBERS))]
    return _replace_match(content, rng, NUMBER, extreme)


def _change_word(content, rng):
    words = WORD.findall(content) or [b"word"]
    return _replace_match(content, rng, WORD, words[rng.integers(len(words))])


MUTATIONS = (_truncate, _change_bytes, _remove, _repeat, _insert, _change_number, _change_word)
