"""Files of the benchmark study: report.html, summary.json, table.md, episodes, figures."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.evaluation import write_episodes
from coopmap_env.studies.benchmark.figures import (
    draw_condition,
    draw_generalization,
    methods_with_baseline,
)
from coopmap_env.studies.benchmark.methods import REFERENCE
from coopmap_env.studies.benchmark.study import BenchmarkStudy, ConditionResult
from coopmap_env.studies.benchmark.summary import benchmark_summary
from coopmap_env.studies.common.pages import format_interval, render_template

Table = list[list[str]]
"""Rows of cells; the first one is the header."""
VERDICT_SCORES = {
    "coverage_auc": ("area under coverage curve", 100.0, "points"),
    "surface_coverage_auc": ("area under surface coverage curve", 100.0, "points"),
    "reward": ("reward", 1.0, "nats"),
}
"""Name, factor and unit of the scores in verdicts."""
ENV_LABELS = {"planar": "Planar-v1", "field": "Field-v1"}


@dataclass(frozen=True)
class Column:
    """One column of a table of methods."""

    title: str
    score: str
    scale: float = 1.0
    digits: int = 2
    statistic: str = "mean"
    """"mean" or "interquartile_mean"; or "difference" or "probability_of_improvement", which
    compare with the method's baseline."""
    bounds: bool = True
    """Whether the cells have the bounds of the interval."""

    def cell(self, method: dict[str, Any]) -> str:
        """Text of a method's cell; "-" if it has no baseline."""
        if self.statistic in ("mean", "interquartile_mean"):
            values = method["scores"][self.score][self.statistic]
        elif method["baseline"]:
            values = method["comparisons"][method["baseline"]][self.statistic][self.score]
        else:
            return "-"
        sign = "+" if self.statistic == "difference" else ""
        return format_interval(values, self.scale, self.digits, self.bounds, sign)


def _area_columns(area: str) -> tuple[Column, ...]:
    return (
        Column("AUC, %", area, 100),
        Column("AUC, interquartile mean, %", area, 100, statistic="interquartile_mean"),
        Column("AUC minus rating function", area, 100, statistic="difference"),
        Column("P(improvement)", area, statistic="probability_of_improvement"),
    )


_REWARD = Column("reward", "reward", digits=1, bounds=False)
_LOG_LOSS = Column("log-loss", "log_loss", digits=4, bounds=False)
_MOTION = Column("motion distance", "motion_distance", digits=0, bounds=False)
_TIME = Column("planning, ms", "planning_time_ms", bounds=False)
COLUMNS = {
    "planar": (
        Column("coverage, %", "coverage", 100),
        *_area_columns("coverage_auc"),
        _REWARD,
        _LOG_LOSS,
        _MOTION,
        _TIME,
    ),
    "field": (
        Column("surface coverage, %", "surface_coverage", 100, 1),
        *_area_columns("surface_coverage_auc"),
        Column("coverage AUC, %", "coverage_auc", 100),
        Column("AUC minus rating function", "coverage_auc", 100, statistic="difference"),
        Column("F-score", "f_score", digits=3, bounds=False),
        _REWARD,
        _LOG_LOSS,
        _MOTION,
        _TIME,
    ),
}
"""Columns of the main table by environment; the report also has all scores with intervals."""
ALL_SCORES = (
    Column("coverage, %", "coverage", 100),
    Column("AUC, %", "coverage_auc", 100),
    Column("surface coverage, %", "surface_coverage", 100),
    Column("AUC, %", "surface_coverage_auc", 100),
    Column("F-score", "f_score", digits=3),
    Column("reward", "reward"),
    Column("log-loss", "log_loss", digits=4),
    Column("motion distance", "motion_distance", digits=1),
    Column("planning, ms", "planning_time_ms", bounds=False),
)


def write_benchmark_report(study: BenchmarkStudy, out: Path) -> dict[str, Any]:
    """Write all files into the folder `out`; return the summary."""
    out.mkdir(parents=True, exist_ok=True)
    summary = benchmark_summary(study)
    for part in summary["main"]:
        draw_condition(part, out / f"{part['env_name']}.png")
    if summary["generalization"]:
        draw_generalization(summary["generalization"], out / "generalization.png")
    for result in study.main:
        _write_csv(result, out / f"{result.condition.env_name}_episodes.csv")
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    write_atomically(out / "table.md", benchmark_text(summary))
    page = render_template(
        "benchmark/report.html",
        out,
        summary=summary,
        verdicts=verdict_table(summary["verdicts"]),
        headlines=headlines(summary),
        env_labels=ENV_LABELS,
        table=main_table,
        scores=all_scores,
        comparisons=comparison_table,
        generalization=generalization_table(summary["generalization"]),
    )
    write_atomically(out / "report.html", page)
    return summary


def benchmark_text(summary: dict[str, Any]) -> str:
    """Tables and verdicts in Markdown, for the terminal and the README."""
    parts = [caption(part) + "\n\n" + _markdown(main_table(part)) for part in summary["main"]]
    if summary["verdicts"]:
        parts.append("\n".join(f"- {line}" for line in headlines(summary)))
        parts.append(_markdown(verdict_table(summary["verdicts"])))
    if summary["generalization"]:
        parts.append(
            "Ratio of the area under the coverage curve to that of the rating function on the same "
            "candidates:\n\n" + _markdown(generalization_table(summary["generalization"]))
        )
    return "\n\n".join(parts) + "\n"


def caption(part: dict[str, Any]) -> str:
    """Explanation of the main table."""
    robots, scans = part["env_kwargs"]["n_robots"], part["env_kwargs"]["max_scans"]
    return (
        f"After {robots * scans} scans of {robots} robots in {ENV_LABELS[part['env_name']]}, "
        f"{part['worlds']} worlds of the test split: means [95 % intervals over worlds and "
        "training runs]. AUC: area under the curve over the scans. Differences are paired by "
        "world: methods with candidates are compared with the rating function on the same "
        "candidates, the "
        f"others with the {REFERENCE}. The planning time excludes the environment's computation of "
        "candidates and their features."
    )


def headlines(summary: dict[str, Any]) -> list[str]:
    """Differences of the first learned method of each environment from planners, by AUC."""
    lines = []
    for part in summary["main"]:
        here = [
            verdict for verdict in summary["verdicts"] if verdict["env_name"] == part["env_name"]
        ]
        for verdict in here:
            first = verdict["learned"] == here[0]["learned"]
            if first and verdict["score"] in part["areas"]:
                name, scale, unit = VERDICT_SCORES[verdict["score"]]
                lines.append(
                    f"{ENV_LABELS[part['env_name']]}, {verdict['learned']} - "
                    f"{verdict['planner']}, {name}: "
                    f"{format_interval(verdict['difference'], scale, sign='+')} {unit} per world, "
                    f"{verdict['verdict']}."
                )
    return lines


def verdict_table(verdicts: list[dict[str, Any]]) -> Table:
    """Differences of learned policies from planners, with verdicts."""
    rows = [["learned", "minus", "score", "difference", "verdict", "each training run"]]
    for verdict in verdicts:
        name, scale, _ = VERDICT_SCORES[verdict["score"]]
        runs = verdict["runs"] if len(verdict["runs"]) > 1 else []
        rows.append(
            [
                f"{ENV_LABELS[verdict['env_name']]}: {verdict['learned']}",
                verdict["planner"],
                name,
                format_interval(verdict["difference"], scale, sign="+"),
                verdict["verdict"],
                ", ".join(f"{scale * run:+.2f}" for run in runs),
            ]
        )
    return rows


def main_table(part: dict[str, Any]) -> Table:
    """Main table of one condition."""
    return _table(part, COLUMNS[part["env_name"]])


def all_scores(part: dict[str, Any]) -> Table:
    """All scores of one condition with intervals."""
    known = next(iter(part["methods"].values()))["scores"]
    return _table(part, tuple(column for column in ALL_SCORES if column.score in known))


def comparison_table(part: dict[str, Any]) -> Table:
    """All comparisons of one condition, by the AUC of its drawn curve."""
    area = part["areas"][0]
    rows = [["method", "minus", "AUC, points", "P(improvement)", "reward", "motion distance"]]
    for label, method in part["methods"].items():
        for other, comparison in method["comparisons"].items():
            change = comparison["difference"]
            rows.append(
                [
                    label,
                    other,
                    format_interval(change[area], 100, sign="+"),
                    format_interval(comparison["probability_of_improvement"][area]),
                    format_interval(change["reward"], sign="+"),
                    format_interval(change["motion_distance"], digits=1, sign="+"),
                ]
            )
    return rows


def generalization_table(conditions: list[dict[str, Any]]) -> Table:
    """Ratios of AUC to that of the rating function, one row for each condition."""
    labels = list(
        dict.fromkeys(label for part in conditions for label in methods_with_baseline(part))
    )
    rows = [["condition", "worlds", *labels]]
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
            [f"{ENV_LABELS[part['env_name']]}: {part['label']}", str(part["worlds"]), *ratios]
        )
    return rows


def _table(part: dict[str, Any], columns: tuple[Column, ...]) -> Table:
    rows = [["method", *(column.title for column in columns)]]
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
