"""Files of the comparison of learned policies and planners: report, summary, figures, table."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.evaluation.comparison import write_episodes
from coopmap_env.evaluation.statistics.bootstrap import Interval
from coopmap_env.studies.benchmark.figures import (
    draw_condition,
    draw_generalization,
    methods_with_baseline,
)
from coopmap_env.studies.benchmark.methods import REFERENCE
from coopmap_env.studies.benchmark.study import BenchmarkStudy, ConditionResult, summary
from coopmap_env.studies.common.pages import render_template

Table = list[list[str]]
"""Rows of cells; the first one is the header."""
VERDICT_SCORES = {
    "coverage_auc": ("area under viewed share", 100.0, "points"),
    "surface_coverage_auc": ("area under covered surface", 100.0, "points"),
    "reward": ("reward", 1.0, "nats"),
}
"""What verdicts call the scores that they are about, and their unit."""
WORLD_LABELS = {"planar": "in the plane", "field": "in the field"}


@dataclass(frozen=True)
class Column:
    """One score of a table."""

    title: str
    score: str
    scale: float = 1.0
    digits: int = 2
    statistic: str = "mean"
    """"mean", "interquartile_mean", or "difference" and "probability_of_improvement": against the
    entry's baseline."""
    interval: bool = True

    def cell(self, method: dict[str, Any]) -> str:
        """What an entry has there."""
        if self.statistic in ("mean", "interquartile_mean"):
            values = method["scores"][self.score][self.statistic]
        elif method["baseline"]:
            values = method["comparisons"][method["baseline"]][self.statistic][self.score]
        else:
            return "-"
        sign = "+" if self.statistic == "difference" else ""
        return format_interval(values, self.scale, self.digits, self.interval, sign)


def _area_columns(area: str) -> tuple[Column, ...]:
    return (
        Column("its mean over the scans, %", area, 100),
        Column("interquartile mean, %", area, 100, statistic="interquartile_mean"),
        Column("less the rating function's", area, 100, statistic="difference"),
        Column("chance of more", area, statistic="probability_of_improvement"),
    )


_REWARD = Column("reward", "reward", digits=1, interval=False)
_LOG_LOSS = Column("log-loss", "log_loss", digits=4, interval=False)
_MOTION = Column("motion", "motion_cost", digits=0, interval=False)
_TIME = Column("ms", "planning_time_ms", interval=False)
COLUMNS = {
    "planar": (
        Column("viewed, %", "coverage", 100),
        *_area_columns("coverage_auc"),
        _REWARD,
        _LOG_LOSS,
        _MOTION,
        _TIME,
    ),
    "field": (
        Column("surface, %", "surface_coverage", 100, 1),
        *_area_columns("surface_coverage_auc"),
        Column("viewed share, mean over the scans, %", "coverage_auc", 100),
        Column("less the rating function's", "coverage_auc", 100, statistic="difference"),
        Column("F-score", "f_score", digits=3, interval=False),
        _REWARD,
        _LOG_LOSS,
        _MOTION,
        _TIME,
    ),
}
"""Of the table that is printed. The report has all scores with their intervals."""
ALL_SCORES = (
    Column("viewed, %", "coverage", 100),
    Column("area under it, %", "coverage_auc", 100),
    Column("surface, %", "surface_coverage", 100),
    Column("area under it, %", "surface_coverage_auc", 100),
    Column("F-score", "f_score", digits=3),
    Column("reward", "reward"),
    Column("log-loss", "log_loss", digits=4),
    Column("motion", "motion_cost", digits=1),
    Column("ms", "planning_time_ms", interval=False),
)


def write_benchmark_report(study: BenchmarkStudy, out: Path) -> dict[str, Any]:
    """Write everything into the folder `out`; the summary is returned too."""
    out.mkdir(parents=True, exist_ok=True)
    found = summary(study)
    for part in found["main"]:
        draw_condition(part, out / f"{part['world']}.png")
    if found["generalization"]:
        draw_generalization(found["generalization"], out / "generalization.png")
    for result in study.main:
        _write_csv(result, out / f"{result.condition.world}_episodes.csv")
    write_atomically(out / "summary.json", json.dumps(found, indent=2) + "\n")
    write_atomically(out / "table.md", text_summary(found))
    page = render_template(
        "benchmark/report.html",
        out,
        {},
        found=found,
        verdicts=verdict_table(found["verdicts"]),
        headlines=headlines(found),
        worlds=WORLD_LABELS,
        table=main_table,
        scores=all_scores,
        comparisons=comparison_table,
        generalization=generalization_table(found["generalization"]),
    )
    write_atomically(out / "report.html", page)
    return found


def text_summary(found: dict[str, Any]) -> str:
    """Tables and verdicts in Markdown, for the terminal and the README."""
    parts = [caption(part) + "\n\n" + _markdown(main_table(part)) for part in found["main"]]
    if found["verdicts"]:
        parts.append("\n".join(f"- {line}" for line in headlines(found)))
        parts.append(_markdown(verdict_table(found["verdicts"])))
    if found["generalization"]:
        parts.append(
            "Area under the curve over the rating function's on as many candidates:\n\n"
            + _markdown(generalization_table(found["generalization"]))
        )
    return "\n\n".join(parts) + "\n"


def caption(part: dict[str, Any]) -> str:
    """What a table stands on."""
    robots, scans = part["arguments"]["n_robots"], part["arguments"]["max_scans"]
    return (
        f"After {robots * scans} scans of {robots} robots {WORLD_LABELS[part['world']]}, "
        f"{part['worlds']} worlds of the test split: means [95 % intervals over worlds and "
        "training runs]. Less the rating function's: paired by world with that on as many "
        f"candidates, and of all others with the {REFERENCE}. The ms of a decision leave out what "
        "the environment computes to offer candidates, their features included."
    )


def headlines(found: dict[str, Any]) -> list[str]:
    """The first learned entry of each world less planners, by the areas under curves."""
    lines = []
    for part in found["main"]:
        here = [verdict for verdict in found["verdicts"] if verdict["world"] == part["world"]]
        for verdict in here:
            first = verdict["learned"] == here[0]["learned"]
            if first and verdict["score"] in part["areas"]:
                name, scale, unit = VERDICT_SCORES[verdict["score"]]
                lines.append(
                    f"{WORLD_LABELS[part['world']].capitalize()}, {verdict['learned']} - "
                    f"{verdict['planner']}, {name}: "
                    f"{format_interval(verdict['difference'], scale, sign='+')} {unit} per world, "
                    f"{verdict['verdict']}."
                )
    return lines


def verdict_table(verdicts: list[dict[str, Any]]) -> Table:
    """Learned policies less planners, and where the intervals lie."""
    rows = [["learned", "less", "in", "difference", "", "each training run"]]
    for verdict in verdicts:
        name, scale, _ = VERDICT_SCORES[verdict["score"]]
        runs = verdict["runs"] if len(verdict["runs"]) > 1 else []
        rows.append(
            [
                f"{WORLD_LABELS[verdict['world']]}: {verdict['learned']}",
                verdict["planner"],
                name,
                format_interval(verdict["difference"], scale, sign="+"),
                verdict["verdict"],
                ", ".join(f"{scale * run:+.2f}" for run in runs),
            ]
        )
    return rows


def main_table(part: dict[str, Any]) -> Table:
    """The printed table of one condition."""
    return _table(part, COLUMNS[part["world"]])


def all_scores(part: dict[str, Any]) -> Table:
    """All scores of one condition with intervals."""
    known = next(iter(part["methods"].values()))["scores"]
    return _table(part, tuple(column for column in ALL_SCORES if column.score in known))


def comparison_table(part: dict[str, Any]) -> Table:
    """All comparisons of one condition, by its first area under a curve."""
    area = part["areas"][0]
    rows = [["", "less", "area, points", "chance of more", "reward", "motion"]]
    for label, method in part["methods"].items():
        for other, against in method["comparisons"].items():
            change = against["difference"]
            rows.append(
                [
                    label,
                    other,
                    format_interval(change[area], 100, sign="+"),
                    format_interval(against["probability_of_improvement"][area]),
                    format_interval(change["reward"], sign="+"),
                    format_interval(change["motion_cost"], digits=1, sign="+"),
                ]
            )
    return rows


def generalization_table(conditions: list[dict[str, Any]]) -> Table:
    """Ratios of areas under the curve to the rating function's, a row a condition."""
    labels = list(
        dict.fromkeys(label for part in conditions for label in methods_with_baseline(part))
    )
    rows = [["worlds and teams", "number", *labels]]
    for part in conditions:
        area, compared = part["areas"][0], methods_with_baseline(part)
        ratios = [
            format_interval(
                compared[label]["comparisons"][compared[label]["baseline"]]["ratio"][area]
            )
            if label in compared
            else "-"
            for label in labels
        ]
        rows.append(
            [f"{WORLD_LABELS[part['world']]}: {part['label']}", str(part["worlds"]), *ratios]
        )
    return rows


def format_interval(
    values: dict[str, float],
    unit: float = 1.0,
    digits: int = 2,
    interval: bool = True,
    sign: str = "",
) -> str:
    """An interval in another unit, or its estimate alone."""
    in_unit = Interval(**{name: unit * value for name, value in values.items()})
    spec = f"{sign}.{digits}f"
    return format(in_unit, spec) if interval else format(in_unit.estimate, spec)


def _table(part: dict[str, Any], columns: tuple[Column, ...]) -> Table:
    rows = [["policy", *(column.title for column in columns)]]
    for label, method in part["methods"].items():
        runs = len(method["policies"])
        name = f"{label} ({runs} training runs)" if runs > 1 else label
        rows.append([name, *(column.cell(method) for column in columns)])
    return rows


def _markdown(table: Table) -> str:
    lines = [f"| {' | '.join(row)} |" for row in table]
    lines.insert(1, "|" + "---|" * len(table[0]))
    return "\n".join(lines)


def _write_csv(result: ConditionResult, path: Path) -> None:
    runs = {
        f"{method_result.method.label}; {spec}": evaluation
        for method_result in result.method_results
        for spec, evaluation in zip(
            method_result.method.policy_specs, method_result.runs, strict=True
        )
    }
    write_episodes(runs, path)
