"""The command; see the package's page."""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log as log_line
from coopmap_env.core.version import __version__
from coopmap_env.studies.common.records import significant
from coopmap_env.studies.equality import (
    Case,
    Counts,
    DifferenceError,
    field_cases,
    planar_cases,
    play_case,
)


def play_cases(
    cases: Iterable[Case], n_steps: int, seed: int, log: Callable[[str], None]
) -> dict[str, Any]:
    """Play as many steps in all cases together, as JSON values.

    Raises
    ------
    DifferenceError
        At the first difference.
    """
    chosen = list(cases)
    total, start, record = Counts(), time.perf_counter(), []
    for k, case in enumerate(chosen, start=1):
        goal = n_steps * k // len(chosen)
        if total.steps >= goal:
            continue
        counts = play_case(case, goal - total.steps, np.random.default_rng([seed, k]))
        total += counts
        rate = total.steps / (time.perf_counter() - start)
        log(f"{k} of {len(chosen)}: {case}: {total.steps:,} steps, {rate:.0f} a second, all equal")
        record.append({**case.arguments, **case.options, "steps": counts.steps})
    seconds = time.perf_counter() - start
    return {
        **asdict(total),
        "rejections": dict(total.rejections.most_common()),
        "seconds": significant(seconds),
        "cases": record,
    }


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
    options = parser.parse_args(arguments)
    record: dict[str, Any] = {"seed": options.seed, "versions": versions(), "difference": None}
    plays = {
        "planar": (planar_cases, options.planar_steps),
        "field": (field_cases, options.field_steps),
    }
    try:
        for kind, (cases, n_steps) in plays.items():
            if n_steps > 0:
                record[kind] = play_cases(cases(), n_steps, options.seed, log_line)
    except DifferenceError as error:
        record["difference"] = {"text": str(error), **error.difference._asdict()}
        log_line(f"difference: {error}")
    write_atomically(options.out, json.dumps(record, indent=1) + "\n")
    if record["difference"] is not None:
        sys.exit(1)
    log_line(f"no difference; record: {options.out}")


def versions() -> dict[str, str]:
    """Versions of what decides the bits."""
    return {
        "coopmap": __version__,
        "python": platform.python_version(),
        "processor": platform.machine(),
        **{name: version(name) for name in ("numpy", "numba", "gymnasium")},
    }


if __name__ == "__main__":
    main()
