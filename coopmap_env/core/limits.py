"""Limits on sizes: what a file or an argument announces is checked before memory is asked for.

A file's header, an archive's table of contents or a shape in a YAML file are checked against these
limits before anything of that size is read or made. Both limits are raised by environment
variables, which worker processes inherit:

====================  ==============  ==========================================================
variable              default         limits
====================  ==============  ==========================================================
COOPMAP_MAX_CELLS     67,108,864      cells of a map or world, pixels of an image (8192 x 8192)
COOPMAP_MAX_BYTES     1,073,741,824   a file, and what is unpacked from one (1 GiB)
====================  ==============  ==========================================================
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterable

MAX_CELLS_VARIABLE, MAX_CELLS = "COOPMAP_MAX_CELLS", 1 << 26
MAX_BYTES_VARIABLE, MAX_BYTES = "COOPMAP_MAX_BYTES", 1 << 30


def check_cells(shape: Iterable[int], what: str) -> None:
    """Check a number of cells or pixels, given by the sizes along each axis.

    Raises
    ------
    ValueError
        With `what`, the number, the limit and the variable that raises it.
    """
    _check(math.prod(shape), "cells", what, MAX_CELLS_VARIABLE, MAX_CELLS)


def check_bytes(size: int, what: str) -> None:
    """Check a number of bytes.

    Raises
    ------
    ValueError
        With `what`, the number, the limit and the variable that raises it.
    """
    _check(size, "bytes", what, MAX_BYTES_VARIABLE, MAX_BYTES)


def _check(size: int, unit: str, what: str, variable: str, default: int) -> None:
    limit = _limit(variable, default)
    if size > limit:
        shown = f"{size:,}" if size < 10**15 else "over 10**15"
        raise ValueError(
            f"{what} has {shown} {unit}, more than the limit of {limit:,}; "
            f"the environment variable {variable} raises it"
        )


def _limit(variable: str, default: int) -> int:
    text = os.environ.get(variable, "")
    if not text:
        return default
    if not (text.isascii() and text.isdigit() and 0 < len(text) <= 15 and int(text) > 0):
        raise ValueError(f"{variable} must be an integer above 0, such as {default}, got {text!r}")
    return int(text)
