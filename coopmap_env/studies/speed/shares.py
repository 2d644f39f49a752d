"""How much of a step is compiled code: ``python -m coopmap_env.studies.speed.shares CASE``.

What would be left if Python took no time at all bounds what can be gained by moving more of it into
kernels. The steps of a case are played several times, with and without a profiler that times each
call; of each step the shortest counts, so that the shares hold on a busy machine. Kernels and
functions of other libraries do nothing in Python, so the profiler makes them hardly longer.
"""

from __future__ import annotations

import argparse
import cProfile
import gc
import pstats
import time
from collections.abc import Callable
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np
from numba.core.dispatcher import Dispatcher

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.progress import log
from coopmap_env.envs import MappingEnv
from coopmap_env.studies.speed.cases import CASES, Run

LIBRARY_FUNCTIONS = ("intersect", "simulate_point_cloud")
"""Functions that do little but call Embree, or numpy's generator."""


class Shares(NamedTuple):
    """Mean milliseconds of a step of all robots."""

    step: float
    kernels: float
    libraries: float
    """Embree, PyBullet, and numpy's normal draws."""

    @property
    def python(self) -> float:
        """What is left."""
        return self.step - self.kernels - self.libraries


def measure_shares(run: Run, n_runs: int) -> Shares:
    """Play the steps of a case, after once for compilation."""
    run()
    kernels = kernel_functions()
    times, parts = [], []
    for k in range(n_runs):
        log(f"run {k + 1} of {n_runs}")
        times.append(_each_step(run, _timed))
        parts.append([_compiled(stats, kernels) for stats in _each_step(run, _profiled)])
    shortest = np.min(parts, axis=0).mean(axis=0)
    return Shares(*(1e3 * np.array([np.min(times, axis=0).mean(), *shortest])).tolist())


def kernel_functions() -> set[tuple[str, str]]:
    """File and name of every kernel."""
    # `isinstance` would ask objects of other libraries for their class, and some of these warn
    kernels = (one for one in gc.get_objects() if issubclass(type(one), Dispatcher))
    codes = (one.py_func.__code__ for one in kernels)
    return {(code.co_filename, code.co_name) for code in codes}


def _each_step(run: Run, measure: Callable[[Callable[[], Any]], tuple[Any, Any]]) -> list[Any]:
    """What is measured of each step of a run."""
    found, step = [], MappingEnv.step

    def measured(env: MappingEnv[Any], actions: Any) -> Any:
        result, value = measure(lambda: step(env, actions))
        found.append(value)
        return result

    with patch.object(MappingEnv, "step", measured):
        run()
    return found


def _timed(step: Callable[[], Any]) -> tuple[Any, float]:
    start = time.process_time()
    result = step()
    return result, time.process_time() - start


def _profiled(step: Callable[[], Any]) -> tuple[Any, Any]:
    profile = cProfile.Profile()
    result = profile.runcall(step)
    return result, pstats.Stats(profile)


def _compiled(stats: Any, kernels: set[tuple[str, str]]) -> tuple[float, float]:
    """Seconds of a step in kernels and in libraries."""
    in_kernels = in_libraries = 0.0
    for (path, _, name), values in stats.stats.items():
        if (path, name) in kernels:
            in_kernels += values[2]
        elif "pybullet" in name or name in LIBRARY_FUNCTIONS:
            in_libraries += values[2]
    return in_kernels, in_libraries


def main(arguments: list[str] | None = None) -> None:
    """Print the shares of a case."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.speed.shares",
        description="How much of a step is compiled code.",
    )
    parser.add_argument("case", choices=[name for name in CASES if "vector" not in name])
    parser.add_argument("--runs", type=int, default=10, help="of the case")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs must be at least 1, got {options.runs}")
    found = measure_shares(CASES[options.case](), options.runs)
    for name in ("step", "kernels", "libraries", "python"):
        value = getattr(found, name)
        print(f"{value:8.3f} ms {value / found.step:6.1%}  {name}")


if __name__ == "__main__":
    with errors_as_lines("shares"):
        main()
