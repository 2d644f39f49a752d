"""Studies that play policies on the worlds of tasks, and write a page with one table."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log
from coopmap_env.simulation.scenes import SPLITS


class Worlds(NamedTuple):
    """The first worlds of a split, and where what is played on them is kept."""

    split: str
    n: int
    folder: Path
    workers: int


def run_table_study(
    module: str,
    description: str,
    tasks: Iterable[str],
    play: Callable[[str, Worlds], Any],
    table_text: Callable[[Mapping[str, Any]], str],
    page_text: Callable[[str, str, int], str],
    arguments: Sequence[str] | None = None,
) -> None:
    """Play all tasks, print the table, write the page.

    Parameters
    ----------
    module : str
        What ``python -m`` runs.
    description : str
        For ``--help``.
    tasks : iterable of str
        Names.
    play : callable
        What a task brings; resumable.
    table_text : callable
        The table in Markdown, of what each task brought by its name.
    page_text : callable
        The page, of the table, the split and the number of worlds.
    arguments : sequence of str, optional
        Of the command; wrong ones exit with 2.
    """
    parser = argparse.ArgumentParser(prog=f"python -m {module}", description=description)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--worlds", type=int, default=20, help="two or more, from seed 0 on")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder of episodes and bounds")
    parser.add_argument("--page", type=Path, help="file of the page")
    options = parser.parse_args(arguments)
    if options.worlds < 2:
        parser.error(f"--worlds must be at least 2, got {options.worlds}")
    worlds = Worlds(options.split, options.worlds, options.out, options.workers)
    table = table_text({name: play(name, worlds) for name in tasks})
    print(table)
    if options.page is not None:
        write_atomically(options.page, page_text(table, worlds.split, worlds.n))
        log(f"page: {options.page}")
