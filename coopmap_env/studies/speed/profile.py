"""Where the time of a step goes: ``python -m coopmap_env.studies.speed.profile CASE``.

A sampling profile: every few milliseconds of processor time it is looked which line runs, and the
time since the last look counts for that line. It costs nothing in between, so that small functions
do not look larger than they are, as they do where each call is timed. While a kernel runs nobody
looks: all of its time counts, at its end, for the line that called it. Lines of libraries count
for the line of the project that calls them.

What a step takes is its mean, disturbed by what else runs; the shares hold on a busy machine.
"""

from __future__ import annotations

import argparse
import linecache
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any, NamedTuple

import coopmap_env
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.progress import log
from coopmap_env.studies.speed.cases import CASES, Run

PERIOD_S = 2e-3
"""Processor time between two looks; systems with a coarser clock look less often."""
ROOT = Path(coopmap_env.__file__).parent
OUTER = ("studies", "evaluation", "cli")
"""Packages that call a step, and are no part of it."""


class Line(NamedTuple):
    """A line of the project's code."""

    path: str
    number: int

    @property
    def module(self) -> str:
        """Its file, from the package on."""
        return Path(self.path).relative_to(ROOT).with_suffix("").as_posix()

    @property
    def text(self) -> str:
        """What stands there."""
        return linecache.getline(self.path, self.number).strip()


@dataclass
class Samples:
    """Processor time of the lines of a step."""

    seconds: dict[Line, float] = field(default_factory=dict)
    n_looks: int = 0

    def of(self, key: Callable[[Line], Any], n: int) -> list[tuple[Any, float]]:
        """The n largest groups of lines with an equal key: the key and the share of all time."""
        total, groups = sum(self.seconds.values()), dict[Any, float]()
        for line, seconds in self.seconds.items():
            groups[key(line)] = groups.get(key(line), 0.0) + seconds / total
        return sorted(groups.items(), key=lambda group: -group[1])[:n]


@contextmanager
def sampled_lines(
    period: float = PERIOD_S, clock: Callable[[], float] = time.process_time
) -> Iterator[Samples]:
    """Measure the lines of steps until the block ends."""
    samples, last = Samples(), clock()

    def look(_: int, frame: FrameType | None) -> None:
        nonlocal last
        now, inner = clock(), innermost_line(frame)
        if inner is not None:
            samples.seconds[inner] = samples.seconds.get(inner, 0.0) + now - last
            samples.n_looks += 1
        last = now

    before = signal.signal(signal.SIGPROF, look)
    signal.setitimer(signal.ITIMER_PROF, period, period)
    try:
        yield samples
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
        signal.signal(signal.SIGPROF, before)


def innermost_line(frame: FrameType | None) -> Line | None:
    """The line of the project in which the program is; None outside of a step."""
    inner, in_step = None, False
    while frame is not None:
        path = Path(frame.f_code.co_filename)
        if path.is_relative_to(ROOT) and path.relative_to(ROOT).parts[0] not in OUTER:
            inner = inner or Line(str(path), frame.f_lineno)
            in_step = in_step or frame.f_code.co_name == "step"
        frame = frame.f_back
    return inner if in_step else None


def table(samples: Samples, step_ms: float, n_lines: int) -> str:
    """The modules in which most of a step's time goes, and the lines, as text."""
    if samples.n_looks == 0:
        sys.exit("the steps were over before the first look: ask for more runs by --runs")
    rows = [f"{samples.n_looks:,} looks; {step_ms:.3f} ms a step", "", "      ms  share"]
    for module, share in samples.of(lambda line: line.module, n_lines):
        rows.append(f"{step_ms * share:8.3f} {share:6.1%}  {module}")
    rows += ["", "      ms  share"]
    for line, share in samples.of(lambda line: line, n_lines):
        place = f"{line.module}:{line.number}"
        rows.append(f"{step_ms * share:8.3f} {share:6.1%}  {place}  {line.text}")
    return "\n".join(rows)


def profile(run: Run, n_runs: int) -> tuple[Samples, float]:
    """Samples of the steps of some runs, after one that compiles; and ms of a step."""
    run()
    seconds = []
    with sampled_lines() as samples:
        for k in range(n_runs):
            log(f"run {k + 1} of {n_runs}")
            seconds += run()["step"]
    return samples, 1e3 * sum(seconds) / len(seconds)


def main(arguments: list[str] | None = None) -> None:
    """Print the table of a case."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.speed.profile",
        description="Where the time of a step of all robots goes.",
    )
    parser.add_argument("case", choices=CASES)
    parser.add_argument("--runs", type=int, default=20, help="of the case")
    parser.add_argument("--lines", type=int, default=25, help="in each table")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, got {options.runs}")
    if not hasattr(signal, "setitimer"):
        sys.exit("this system has no timer of processor time")
    print(table(*profile(CASES[options.case](), options.runs), options.lines))


if __name__ == "__main__":
    with errors_as_lines("profile"):
        main()
