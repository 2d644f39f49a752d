"""A small report of runs: a table with 95 % intervals, and one figure of what a policy costs.

It ends with the command that made it and the versions, so that the run can be repeated.

The figure has the score against scans, and the final score against the time of a decision and
against motion.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coopmap_env.core.extras import import_optional, missing_extras, pip_command
from coopmap_env.core.files import write_atomically
from coopmap_env.core.versions import versions
from coopmap_env.evaluation.figures import COLORS, import_pyplot, plot_curves, save_figure
from coopmap_env.evaluation.saved_run import SavedRun
from coopmap_env.evaluation.tables import format_interval, markdown_table

REPORT_FILE, FIGURE_FILE = "report.md", "figure.png"
LIBRARIES = ("numpy", "numba", "matplotlib")
"""Their versions are in the report, beside those of coopmap and Python."""
SHARED = ("id", "scene", "n_robots", "max_scans", "max_time", "split", "mount")
"""Entries of an environment in which runs may differ, so that a note has to say so."""


class Column(NamedTuple):
    """A column of the table."""

    score: str
    title: str
    scale: float
    digits: int


COLUMNS = (
    Column("surface_coverage", "surface, %", 100.0, 1),
    Column("coverage", "observed, %", 100.0, 2),
    Column("coverage_auc", "area under its curve, %", 100.0, 2),
    Column("f_score", "F-score", 1.0, 3),
    Column("log_loss", "log-loss, nats", 1.0, 4),
    Column("efficiency", "efficiency, %", 100.0, 1),
    Column("motion_distance", "motion, sum of d", 1.0, 1),
    Column("planning_time_ms", "decision, ms", 1.0, 2),
)
"""Those of which a run has no score are left out."""
MOTION, TIME = "motion_distance", "planning_time_ms"


def join_runs(runs: Mapping[str, SavedRun]) -> SavedRun:
    """The policies of several runs in one.

    A policy that several runs have is named with its run.

    Parameters
    ----------
    runs : mapping of str to SavedRun
        By name, at least one.
    """
    names = [name for run in runs.values() for name in run.evaluations]
    joined = {
        f"{name} ({folder})" if names.count(name) > 1 else name: evaluation
        for folder, run in runs.items()
        for name, evaluation in run.evaluations.items()
    }
    return SavedRun(next(iter(runs.values())).env, joined)


def differences(runs: Mapping[str, SavedRun]) -> list[str]:
    """What runs do not share: notes for readers, empty if they played the same worlds."""
    notes = []
    for entry in SHARED:
        values = {name: run.env.get(entry) for name, run in runs.items()}
        if len({str(value) for value in values.values()}) > 1:
            shown = "; ".join(f"{value} in {name}" for name, value in values.items())
            notes.append(f"{entry} differs: {shown}")
    evaluations = [one for run in runs.values() for one in run.evaluations.values()]
    if len({tuple(episode.seed for episode in one.episodes) for one in evaluations}) > 1:
        notes.append("the worlds differ: differences between policies contain those of the worlds")
    return notes


def table_lines(run: SavedRun) -> list[str]:
    """The table as Markdown, which terminals show too: means over the worlds [95 % intervals]."""
    tables = {name: evaluation.table for name, evaluation in run.evaluations.items()}
    columns = [
        column for column in COLUMNS if all(column.score in table for table in tables.values())
    ]
    rows = [["policy", "worlds", *(column.title for column in columns)]]
    for name, table in tables.items():
        cells = [_cell(run.summary[name].get(c.score), table[c.score], c) for c in columns]
        rows.append([name, str(len(table["seed"])), *cells])
    return markdown_table(rows, padded=True).splitlines()


def write_report(
    run: SavedRun, folder: Path, title: str, notes: Sequence[str] = (), command: str = ""
) -> list[Path]:
    """Write report.md and, with the extra ``report``, figure.png.

    Parameters
    ----------
    run : SavedRun
    folder : Path
    title : str
    notes : sequence of str
        Sentences below the table.
    command : str
        The command line that made the run.

    Returns
    -------
    list of Path
        The files that were written.
    """
    paths = [folder / REPORT_FILE]
    lines = [f"# {title}", "", "Means over the worlds [95 % bootstrap intervals].", ""]
    lines += table_lines(run)
    if notes:
        lines += ["", *(f"- {note}" for note in notes)]
    if not missing_extras(["report"]):
        draw_costs(run, folder / FIGURE_FILE)
        paths.append(folder / FIGURE_FILE)
        lines += ["", f"![Score against scans, decision time and motion]({FIGURE_FILE})"]
    if command:
        lines += ["", "```", command, "```"]
    lines += ["", ", ".join(f"{name} {number}" for name, number in versions(LIBRARIES).items())]
    write_atomically(paths[0], "\n".join(lines).rstrip() + "\n")
    return paths


def missing_figure_text() -> str | None:
    """A line that says how to get the figure, or None if nothing is missing."""
    missing = missing_extras(["report"])
    return f"{FIGURE_FILE} is left out, which needs: {pip_command(missing)}" if missing else None


def draw_costs(run: SavedRun, path: Path) -> None:
    """Draw the score against scans, and the final score against decision time and motion.

    The score is the visible surface where all episodes have it, else the observed fraction.
    """
    curves = [evaluation.curves for evaluation in run.evaluations.values()]
    has_surface = all("surface_coverage" in one for one in curves)
    score = "surface_coverage" if has_surface else "coverage"
    label = "% of visible surface covered" if has_surface else "% of world observed"
    figure, axes = import_pyplot().subplots(
        1, 3, figsize=(15, 5), sharey=True, layout="constrained"
    )
    plot_curves(axes[0], run.evaluations, run.n_robots, score, label)
    for axis, cost, text in (
        (axes[1], TIME, "time of a decision of one robot, ms"),
        (axes[2], MOTION, "motion of the team, sum of d (Eq. 5)"),
    ):
        for k, (name, evaluation) in enumerate(run.evaluations.items()):
            x, y = (
                _with_bars(run.summary[name].get(key), evaluation.table[key], scale)
                for key, scale in ((cost, 1.0), (score, 100.0))
            )
            axis.errorbar(
                x[0], y[0], xerr=[[x[1]], [x[2]]], yerr=[[y[1]], [y[2]]],
                fmt="o", color=COLORS[k % len(COLORS)], label=name, capsize=2,
            )  # fmt: skip
        axis.set_xlabel(text)
        axis.grid(alpha=0.3)
    _scale_by_decades(axes[1])
    handles, names = axes[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper center", ncols=min(4, len(names)), fontsize=9)
    save_figure(figure, path)


def _scale_by_decades(axis: Any) -> None:
    """A logarithmic scale with few numbers that are written out."""
    ticker = import_optional("matplotlib.ticker", "report")
    axis.set_xscale("log")
    axis.xaxis.set_major_locator(ticker.LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.xaxis.set_major_formatter("{x:g}")
    axis.xaxis.set_minor_formatter(ticker.NullFormatter())


def _cell(interval: dict[str, Any] | None, values: Any, column: Column) -> str:
    """A mean with its interval; the mean alone where one world has no interval."""
    if interval is None:
        return f"{column.scale * np.nanmean(values):.{column.digits}f}"
    return format_interval(interval["mean"], column.scale, column.digits)


def _with_bars(
    interval: dict[str, Any] | None, values: Any, scale: float
) -> tuple[float, float, float]:
    """A mean, and the lengths of its interval below and above."""
    if interval is None:
        return scale * float(np.nanmean(values)), 0.0, 0.0
    mean, low, high = (scale * interval["mean"][key] for key in ("estimate", "low", "high"))
    return mean, max(mean - low, 0.0), max(high - mean, 0.0)
