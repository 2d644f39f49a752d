"""The command; see the package's page."""

from __future__ import annotations

import argparse
from pathlib import Path

from coopmap_env import families
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.choices import unknown
from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log
from coopmap_env.simulation.scenes import SPLITS
from coopmap_env.studies.families import PLAYED_POLICIES, page_text, play_family, table_of
from coopmap_env.studies.families.admission import admission_of, admission_text
from coopmap_env.studies.families.page import table_text
from coopmap_env.studies.families.timing import time_policies


def main(arguments: list[str] | None = None) -> None:
    """Play families, print their tables, write their pages."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.families",
        description="Policies and references on the worlds of benchmark families.",
    )
    parser.add_argument("names", nargs="+", metavar="name", help=", ".join(families.FAMILIES))
    parser.add_argument("--split", choices=SPLITS, default="train")
    parser.add_argument("--worlds", type=int, default=10, help="two or more, from seed 0 on")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder of episodes and bounds")
    parser.add_argument("--pages", type=Path, help="folder in which pages are written")
    parser.add_argument("--policies", help="names in the table, separated by semicolons")
    options = parser.parse_args(arguments)
    for name in options.names:
        if name not in families.FAMILIES:
            parser.error(unknown("family", name, families.FAMILIES))
    chosen = [families.get(name) for name in options.names]
    names = None if options.policies is None else options.policies.split(";")
    if options.worlds < 2:
        parser.error(f"--worlds must be at least 2, got {options.worlds}")
    admissions = {}
    for family in chosen:
        played = play_family(
            family, options.split, range(options.worlds), options.out / family.name,
            options.workers, names,
        )  # fmt: skip
        timed = [
            name for name in played.kinds if family.env_name == "planar" or name in PLAYED_POLICIES
        ]
        times = time_policies(family, options.split, 0, timed, options.out / family.name / "times")
        table = table_of(played, times)
        print(f"{family.name}\n{table_text(table)}\n")
        if "random" in played.kinds.values():
            admissions[family.name] = admission_of(table)
        if options.pages is not None:
            path = options.pages / f"{family.name}.md"
            text = page_text(family, table, options.split, options.worlds, options.policies)
            write_atomically(path, text)
            log(f"page: {path}")
    print(admission_text(admissions))


if __name__ == "__main__":
    with errors_as_lines("families"):
        main()
