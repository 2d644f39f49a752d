"""Progress of long work: lines and bars on the standard error stream, apart from results."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from typing import TypeVar

Item = TypeVar("Item")
SECONDS_IN_FILES = 30.0
"""Between two states of a bar where no terminal overwrites the one before."""


def log(text: str) -> None:
    """Print a line of progress."""
    print(text, file=sys.stderr, flush=True)


def progress_bar(
    items: Iterable[Item],
    unit: str,
    total: int | None = None,
    done: int = 0,
    show: bool = True,
) -> Iterable[Item]:
    """The items, with a progress bar while they are iterated.

    Parameters
    ----------
    items : iterable
    unit : str
        What an item is, such as "job".
    total : int, optional
        Number of items, those done before included; the length of the items, if not given.
    done : int
        Items done before.
    show : bool
        Whether to show the bar; the items are returned as they are otherwise.
    """
    if not show:
        return items
    from tqdm import tqdm

    seconds = 0.1 if sys.stderr.isatty() else SECONDS_IN_FILES
    bar: Iterable[Item] = tqdm(
        items, total=total, initial=done, unit=unit, smoothing=0.1, mininterval=seconds,
        maxinterval=seconds,
    )  # fmt: skip
    return bar
