"""The comparison of learned policies and planners: all methods play under all conditions.

All methods play on the same worlds of the test split. The seed decides the world and the start
poses for every action mode. `plan` lists methods and conditions, `summary` has the statistics.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation import Evaluation, compare, make_policy, with_efficiencies
from coopmap_env.studies.benchmark.methods import CLAIRVOYANT, Condition, Method
from coopmap_env.studies.benchmark.plan import BenchmarkPlan
from coopmap_env.studies.clairvoyant import play_clairvoyant

Array = NDArray[np.float64]

BENCHMARK_SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "log_loss",
    "motion_distance",
    "surface_coverage",
    "surface_coverage_auc",
    "f_score",
    "planning_time_ms",
    "efficiency",
    "efficiency_auc",
)
"""Columns of an evaluation's table that are summarised, if the environment has them."""


@dataclass(frozen=True)
class MethodResult:
    """Episodes of a method under a condition."""

    method: Method
    runs: tuple[Evaluation, ...]
    """One for each of its policy specs, on the same worlds."""

    @cached_property
    def scores(self) -> dict[str, Array]:
        """Scores by column, each of shape (n_runs, n_worlds)."""
        tables = [run.table for run in self.runs]
        return {
            name: np.array([table[name] for table in tables])
            for name in BENCHMARK_SCORES
            if name in tables[0]
        }

    def curves(self, name: str) -> Array:
        """Curves, shape (n_runs, n_worlds, n_scans + 1)."""
        return np.array([run.curves[name] for run in self.runs])


@dataclass(frozen=True)
class ConditionResult:
    """Results of all methods under one condition."""

    condition: Condition
    method_results: tuple[MethodResult, ...]

    def result_for(self, method: Method) -> MethodResult:
        """The result of this method."""
        return next(
            method_result for method_result in self.method_results if method_result.method == method
        )


@dataclass(frozen=True)
class BenchmarkStudy:
    """Results of the study, in the order of the plan."""

    main: tuple[ConditionResult, ...]
    sweeps: tuple[ConditionResult, ...] = ()
    generalization: tuple[ConditionResult, ...] = ()
    notes: tuple[str, ...] = ()
    """Those of the plan."""


def run_benchmark(
    store: Path, plan: BenchmarkPlan, workers: int, log: Callable[[str], None]
) -> BenchmarkStudy:
    """Run the study.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not run again.
    plan : BenchmarkPlan
    workers : int
        Processes; the results do not depend on it, planning times apart.
    log : callable
        Receives a line of progress.

    Raises
    ------
    ValueError
        If a policy or an argument of an environment is not accepted.
    ImportError
        With the pip command, if an extra is missing.
    """
    parts = (plan.main, plan.sweeps, plan.generalization)
    methods = (method for part in parts for condition in part for method in condition.methods)
    specs = (s for method in methods if method.family != CLAIRVOYANT for s in method.policy_specs)
    for spec in dict.fromkeys(specs):
        make_policy(spec)  # find a missing model before an hour of episodes
    main, sweeps, generalization = (
        tuple(run_condition(store, condition, workers, log) for condition in part) for part in parts
    )
    return BenchmarkStudy(main, sweeps, generalization, plan.notes)


def run_condition(
    store: Path, condition: Condition, workers: int, log: Callable[[str], None]
) -> ConditionResult:
    """Play the episodes of all methods of a condition; in planar worlds, with efficiencies."""
    log(f"{condition.env_name}, {condition.label}: {condition.n_worlds} test worlds")
    seeds, groups = range(condition.n_worlds), dict[str, list[Method]]()
    runs: dict[str, tuple[Evaluation, ...]] = {}
    for method in condition.methods:  # methods of one environment share its workers
        if method.family == CLAIRVOYANT:
            arguments = {**condition.env_kwargs, **method.env_kwargs}
            (name,) = method.policy_specs
            evaluation = play_clairvoyant(name, seeds, arguments, store, workers=workers)
            runs[method.label] = (evaluation,)
        else:
            groups.setdefault(repr(sorted(method.env_kwargs.items())), []).append(method)
    for methods in groups.values():
        evaluations = compare(
            [spec for method in methods for spec in method.policy_specs],
            seeds,
            {**condition.env_kwargs, **methods[0].env_kwargs},
            store,
            workers=workers,
            env_name=condition.env_name,
        )
        for method in methods:
            runs[method.label] = tuple(evaluations[spec] for spec in method.policy_specs)
    if condition.env_name == "planar":
        runs = _with_efficiencies(store, condition, workers, runs)
    return ConditionResult(
        condition, tuple(MethodResult(method, runs[method.label]) for method in condition.methods)
    )


def _with_efficiencies(
    store: Path, condition: Condition, workers: int, runs: dict[str, tuple[Evaluation, ...]]
) -> dict[str, tuple[Evaluation, ...]]:
    by_run = {f"{label} {k}": run for label, own in runs.items() for k, run in enumerate(own)}
    found = with_efficiencies(
        by_run,
        range(condition.n_worlds),
        dict(condition.env_kwargs),
        store / "bounds",
        workers=workers,
    )
    return {
        label: tuple(found[f"{label} {k}"] for k in range(len(own))) for label, own in runs.items()
    }
