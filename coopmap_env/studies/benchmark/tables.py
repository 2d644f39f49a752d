"""Tables of the benchmark study: rows of text, for the report and in Markdown."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.studies.benchmark.families import SEARCH_POSES
from coopmap_env.studies.benchmark.figures import methods_with_baseline
from coopmap_env.studies.benchmark.verdicts import (
    ENV_LABELS,
    SCORE_TEXTS,
    actions_text,
    headlines,
)

Table = list[list[str]]
"""Rows of cells; the first one is the header."""


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
        Column("AUC minus strongest planner, points", area, 100, statistic="difference"),
        Column("P(improvement)", area, statistic="probability_of_improvement"),
    )


_REWARD = Column("reward, nats", "reward", digits=1, bounds=False)
_LOG_LOSS = Column("log-loss, nats", "log_loss", digits=4, bounds=False)
_MOTION = Column("motion, sum of d", "motion_distance", digits=0, bounds=False)
_TIME = Column("decision, ms", "planning_time_ms", bounds=False)
COLUMNS = {
    "planar": (
        Column("coverage, %", "coverage", 100),
        *_area_columns("coverage_auc"),
        Column("efficiency, %", "efficiency", 100, 1),
        Column("efficiency of the area, %", "efficiency_auc", 100, 1),
        _REWARD,
        _LOG_LOSS,
        _MOTION,
        _TIME,
    ),
    "field": (
        Column("surface coverage, %", "surface_coverage", 100, 1),
        *_area_columns("surface_coverage_auc"),
        Column("coverage AUC, %", "coverage_auc", 100),
        Column("AUC minus strongest planner, points", "coverage_auc", 100, statistic="difference"),
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
    Column("coverage AUC, %", "coverage_auc", 100),
    Column("efficiency, %", "efficiency", 100),
    Column("efficiency of the area, %", "efficiency_auc", 100),
    Column("surface coverage, %", "surface_coverage", 100),
    Column("surface coverage AUC, %", "surface_coverage_auc", 100),
    Column("F-score", "f_score", digits=3),
    Column("reward, nats", "reward"),
    Column("log-loss, nats", "log_loss", digits=4),
    Column("motion, sum of d", "motion_distance", digits=1),
    Column("decision, ms", "planning_time_ms", bounds=False),
)


EFFICIENCY_TEXT = (
    " Efficiency: what was shown beyond the start, as a fraction of what an upper bound allows. "
    "Clairvoyant references know the true world."
)


def benchmark_text(summary: dict[str, Any]) -> str:
    """Tables and verdicts in Markdown, for the terminal and the documentation.

    The verdicts are those on the strongest planner of all families; the report has the others too.
    """
    parts = [f"Note: {note}." for note in summary["notes"]]
    parts += [caption(part) + "\n\n" + markdown_table(main_table(part)) for part in summary["main"]]
    if summary["verdicts"]:
        parts.append("\n".join(f"- {line}" for line in headlines(summary)))
        strongest = [verdict for verdict in summary["verdicts"] if verdict["is_strongest"]]
        parts.append(markdown_table(verdict_table(strongest)))
    for sweep in summary["sweeps"]:
        parts.append(
            f"Learned policies minus planners at equal motion, {ENV_LABELS[sweep['env_name']]}, "
            f"{sweep['worlds']} worlds; {training_text(sweep)} have chosen the planners:\n\n"
            + markdown_table(equal_motion_table(sweep))
        )
    if summary["generalization"]:
        parts.append(
            "Ratio of the area under the coverage curve to that of the planner with the same "
            "actions that was strongest under the first condition on training worlds "
            f"({training_texts(summary['generalization'])}):\n\n"
            + markdown_table(generalization_table(summary["generalization"]))
        )
    return "\n\n".join(parts) + "\n"


def caption(part: dict[str, Any]) -> str:
    """Explanation of the main table."""
    robots, scans = part["env_kwargs"]["n_robots"], part["env_kwargs"]["max_scans"]
    baseline = (
        "Differences are paired by world, from the planner with the same actions (the same "
        f"candidates, or any pose with m = {SEARCH_POSES}) that was strongest on "
        f"{training_text(part)}, which has none. "
    )
    return (
        f"After {robots * scans} scans of {robots} robots in {ENV_LABELS[part['env_name']]}, "
        f"{part['worlds']} worlds of the test split: means [95 % intervals over worlds and "
        "training runs]. AUC: area under the curve over the scans. "
        + (baseline if part["opponents"] else "")
        + "The planning time excludes the environment's computation of candidates and their "
        "features."
    )


def training_text(part: dict[str, Any]) -> str:
    """The number of training worlds that chose the planners of a condition or sweep, in words."""
    return f"{' or '.join(map(str, part['training_worlds'])) or 'no'} training worlds"


def training_texts(parts: list[dict[str, Any]]) -> str:
    """The numbers of training worlds of all environments, in words."""
    texts = (f"{ENV_LABELS[part['env_name']]}: {training_text(part)}" for part in parts)
    return "; ".join(dict.fromkeys(texts))


def verdict_table(verdicts: list[dict[str, Any]]) -> Table:
    """Differences of learned policies from the strongest planner of each family, with verdicts."""
    rows = [["learned", "minus", "score", "difference", "verdict", "each training run"]]
    for verdict in verdicts:
        name, scale, _ = SCORE_TEXTS[verdict["score"]]
        runs = verdict["runs"] if len(verdict["runs"]) > 1 else []
        rows.append(
            [
                f"{ENV_LABELS[verdict['env_name']]}: {verdict['learned']}",
                f"{verdict['spec']}, {actions_text(verdict)}"
                + (" (strongest)" if verdict["is_strongest"] else ""),
                name,
                format_interval(verdict["difference"], scale, sign="+"),
                verdict["verdict"],
                ", ".join(f"{scale * run:+.2f}" for run in runs),
            ]
        )
    return rows


def opponent_table(part: dict[str, Any]) -> Table:
    """The strongest planner of each family by each score, as training worlds have chosen it."""
    rows = [
        [
            "score",
            "actions",
            "planner",
            "mean on training worlds",
            "training worlds",
            "on test worlds",
        ]
    ]
    for opponent in part["opponents"]:
        name, scale, _ = SCORE_TEXTS[opponent["score"]]
        method = part["methods"][opponent["label"]]
        n_candidates = opponent["env_kwargs"].get("n_candidates")
        rows.append(
            [
                name,
                f"{n_candidates} candidates" if n_candidates else f"any pose (m = {SEARCH_POSES})",
                method["policies"][0],
                f"{scale * opponent['training_mean']:.2f}",
                str(opponent["training_worlds"]),
                format_interval(method["scores"][opponent["score"]]["mean"], scale),
            ]
        )
    return rows


def equal_motion_table(sweep: dict[str, Any]) -> Table:
    """Learned policies minus each family of planners at equal motion."""
    rows = [["learned", "minus", "score", "motion, sum of d", "planners", "difference", "verdict"]]
    for entry in sweep["equal_motion"]:
        name, scale, _ = SCORE_TEXTS[entry["score"]]
        rows.append(
            [
                entry["learned"],
                entry["planners"],
                name,
                f"{entry['motion']:.1f}" + ("" if entry["is_equal"] else " (less)"),
                f"{scale * entry['planners_score']:.2f}",
                format_interval(entry["difference"], scale, sign="+"),
                entry["verdict"],
            ]
        )
    return rows


def split_by_score(table: Table) -> list[tuple[str, Table]]:
    """A table with a column "score" as one table for each score, so that each column has one unit.

    Returns
    -------
    list of (str, Table)
        The score, and its rows without that column; the headers have the score's unit.
    """
    header, *rows = table
    at = header.index("score")
    units = {name: unit for name, _, unit in SCORE_TEXTS.values()}
    out = []
    for score in dict.fromkeys(row[at] for row in rows):
        difference = units[score]
        unit_of = dict.fromkeys(("difference", "each training run"), difference)
        value = "%" if difference == "points" else difference
        unit_of |= dict.fromkeys(("planners", "mean on training worlds", "on test worlds"), value)
        titles = [f"{name}, {unit_of[name]}" if name in unit_of else name for name in header]
        kept = [titles, *(row for row in rows if row[at] == score)]
        out.append((score, [[*row[:at], *row[at + 1 :]] for row in kept]))
    return out


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
    rows = [
        ["method", "minus", "AUC, points", "P(improvement)", "reward, nats", "motion, sum of d"]
    ]
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
    """Ratios of AUC to that of the strongest planner, one row for each condition."""
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
