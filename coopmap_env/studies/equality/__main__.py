"""The command; see the package's page."""

from __future__ import annotations

import argparse
import json
import platform
import sys
from pathlib import Path
from typing import Any

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log as log_line
from coopmap_env.core.versions import versions
from coopmap_env.studies.equality.jobs import CASES, play_cases


def main(arguments: list[str] | None = None) -> None:
    """Play all cases, and write the record; exit code 1 after a difference."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.equality",
        description="Compare vector environments with single ones, to the last bit.",
    )
    parser.add_argument("out", type=Path, help="JSON file of the record")
    parser.add_argument("--planar-steps", type=int, default=1_000_000, help="0 for none")
    parser.add_argument("--field-steps", type=int, default=20_000, help="0 for none")
    parser.add_argument("--seed", type=int, default=0, help="of worlds and actions")
    parser.add_argument("--workers", type=int, default=1, help="cases at a time")
    options = parser.parse_args(arguments)
    record: dict[str, Any] = {"seed": options.seed, "versions": own_versions()}
    for kind, n_steps in {"planar": options.planar_steps, "field": options.field_steps}.items():
        if n_steps > 0:
            record[kind] = play_cases(
                kind, n_steps, options.seed, options.out.with_suffix(".cases"), options.workers
            )
    write_atomically(options.out, json.dumps(record, indent=1) + "\n")
    differences = [d for kind in CASES for d in record.get(kind, {}).get("differences", [])]
    for difference in differences:
        log_line(f"difference: {difference['text']}")
    if differences:
        sys.exit(1)
    log_line(f"no difference; record: {options.out}")


def own_versions() -> dict[str, str]:
    """Versions of what decides the bits, and the kind of processor."""
    return {**versions(("numpy", "numba", "gymnasium")), "processor": platform.machine()}


if __name__ == "__main__":
    with errors_as_lines("equality"):
        main()
