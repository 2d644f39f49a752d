"""`python -m coopmap_env.studies.leaderboard FOLDER`: the project's own entries."""

from __future__ import annotations

import argparse
from pathlib import Path

from coopmap_env import families
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.studies.leaderboard.own_entries import entries_of, play_missing


def main(arguments: list[str] | None = None) -> None:
    """Play what is missing; `coopmap score` makes the page of it."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.leaderboard",
        description="Submissions of the project's planners and pretrained policies. Those in the "
        "folder are kept: remove a file to play it again.",
    )
    parser.add_argument("folder", type=Path, help="of the submissions")
    names = ", ".join(families.FAMILIES)
    parser.add_argument(
        "--families", nargs="+", default=list(families.FAMILIES), metavar="NAME",
        help=f"of {names}; by default all of them",
    )  # fmt: skip
    parser.add_argument("--worlds", type=int, default=20, help="the first ones of the test split")
    parser.add_argument("--workers", type=int, default=1)
    options = parser.parse_args(arguments)
    for name in options.families:
        entries = entries_of(families.get(name))
        play_missing(name, entries, options.folder, options.worlds, options.workers)


if __name__ == "__main__":
    with errors_as_lines("leaderboard"):
        main()
