"""The table of a family: means over its worlds with 95 % intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import (
    Interval,
    bootstrap_mean,
    bootstrap_paired_difference,
)
from coopmap_env.studies.families.play import Played


class Column(NamedTuple):
    """A column of the table."""

    title: str
    score: str
    scale: float
    digits: int


PLANAR_COLUMNS = (
    Column("shown, %", "shown", 100, 1),
    Column("efficiency, %", "efficiency", 100, 1),
    Column("of area, %", "efficiency_auc", 100, 1),
)
FIELD_COLUMNS = (
    Column("surface, %", "surface_coverage", 100, 1),
    Column("area, %", "surface_coverage_auc", 100, 1),
    Column("shown, %", "shown", 100, 1),
)
SCANS = Column("scans", "n_scans", 1, 1)


class Row(NamedTuple):
    """A policy in the table."""

    name: str
    kind: str
    scores: dict[str, Interval]
    """By score; a bound has only what it bounds."""
    beyond: Interval | None
    """First score of the columns less that of the best one-step planner, world by world; None for
    that planner itself."""
    decision_ms: float | None = None
    """Of one robot; see `timing`."""


class BoundSummary(NamedTuple):
    """What can be shown at the end: means over the worlds, and what it takes to know."""

    most: Interval
    """Fraction of the cells; in field families, of the visible surface."""
    gap: Interval
    """By how much the bound exceeds the best choice of views that is known; see
    `coopmap_env.evaluation.bounds.ShownBound`."""
    n_scans: int
    """Of each robot."""
    cpu_seconds: float
    """Median of the searches, as the first one may compile kernels; nan if none was timed."""


class Table(NamedTuple):
    """The rows, and what they are compared by."""

    columns: tuple[Column, ...]
    rows: list[Row]
    compared: Column
    best_one_step: str
    bound: BoundSummary | None = None


def table_of(played: Played, decision_ms: Mapping[str, float] | None = None) -> Table:
    """Summarise what was played, with the time of a decision where it is known.

    Policies are compared by efficiency at the end, in field families by the covered surface.
    """
    tables = {name: evaluation.table for name, evaluation in played.evaluations.items()}
    is_planar = all("efficiency" in table for table in tables.values())
    columns = PLANAR_COLUMNS if is_planar else FIELD_COLUMNS
    compared = columns[1] if is_planar else columns[0]
    one_step = [name for name, kind in played.kinds.items() if kind == "one step"]
    best = max(one_step, key=lambda name: float(tables[name][compared.score].mean()))
    rows = []
    for name, table in tables.items():
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        scores = {
            column.score: bootstrap_mean(table[column.score], rng) for column in (*columns, SCANS)
        }
        beyond = None
        if name != best:
            ours, theirs = table[compared.score], tables[best][compared.score]
            beyond = bootstrap_paired_difference(ours, theirs, rng)
        own_ms = None if decision_ms is None else decision_ms.get(name)
        rows.append(Row(name, played.kinds[name], scores, beyond, own_ms))
    bound = _summarise_bounds(played)
    if bound is not None:
        rows.append(Row("upper bound", "bound", {columns[0].score: bound.most}, None))
    return Table((*columns, SCANS), rows, compared, best, bound)


def _summarise_bounds(played: Played) -> BoundSummary | None:
    rng, times = np.random.default_rng(BOOTSTRAP_SEED), list[float]()
    if played.surface_bounds is not None:
        most, choice, n_scans = played.surface_bounds
        gaps = most / choice - 1
    elif played.shown_bounds:
        most = np.array([own.bounds[-1] for own in played.shown_bounds]) / played.n_cells
        gaps = np.array([own.gap for own in played.shown_bounds])
        times = [own.cpu_seconds for own in played.shown_bounds if not math.isnan(own.cpu_seconds)]
        n_scans = len(played.shown_bounds[0].bounds) - 1
    else:
        return None
    return BoundSummary(
        bootstrap_mean(most, rng),
        bootstrap_mean(gaps, rng),
        n_scans,
        statistics.median(times) if times else math.nan,
    )
