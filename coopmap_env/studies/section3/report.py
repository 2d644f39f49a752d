"""Files of the Section 3 study: report.html, table1.csv, summary.json, figures; and its text."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.files import write_atomically
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation, summarize
from coopmap_env.evaluation.figures import draw_coverage_curves, save_frame
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.evaluation.tables import format_interval
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.field.report import (
    MAP_COLUMNS,
    REPLAY_FILE,
    SCORE_COLUMNS,
    field_summary,
    write_field_figures,
)
from coopmap_env.studies.field.study import FieldStudy
from coopmap_env.studies.section3 import figures
from coopmap_env.studies.section3.setting import (
    PAPER_TABLE_1,
    RASTER,
    SCANS_EACH,
    TABLE_1_SCORES,
    section3_scene,
)
from coopmap_env.studies.section3.study import TABLE_1_COLUMNS, Section3, search_spec
from coopmap_env.studies.section3.table_fit.flatness import PROFILE_FACTORS
from coopmap_env.studies.section3.table_fit.record import SearchSize, read_record
from coopmap_env.studies.section3.table_fit.verdicts import constant_verdicts
from coopmap_env.studies.section3.trends import equal_coverage, extent_decreases


def write_report(study: Section3, out: Path, field: FieldStudy | None = None) -> None:
    """Write all files.

    Parameters
    ----------
    study : Section3
    out : Path
        Folder of the files; it is made if needed.
    field : FieldStudy, optional
        Without it, the report covers the planar environment only.
    """
    out.mkdir(parents=True, exist_ok=True)
    _draw_figures(study, out)
    summary = section3_summary(study)
    if field is not None:
        write_field_figures(field, out)
        summary["field"] = field_summary(field)
    write_atomically(out / "table1.csv", _table_1_csv(study))
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    write_atomically(out / "report.html", _render_html(study, summary, out))


def section3_summary(study: Section3) -> dict[str, Any]:
    """All results as JSON values."""
    return {
        "version": __version__,
        "settings": {
            "planar": settings_to_dict(study.settings),
            "n_robots": 2,
            "scans_each": SCANS_EACH,
            "scene": settings_to_dict(section3_scene()),
            "split": "test",
            "worlds": study.size.worlds,
        },
        "table_1": {
            _search_label(search): {name: interval.as_dict() for name, interval in row.items()}
            for search, row in study.table_1().items()
        },
        "mean_deviation": study.deviation().as_dict(),
        "trends": {name: trend.as_dict() for name, trend in study.trends.items()},
        "readings": {
            f"{hidden}, {interpretation}": _mean_scores(results)
            for (hidden, interpretation), results in study.readings.items()
        },
        "sensitivity_to_K": {str(K): _mean_scores(results) for K, results in study.sweep.items()},
        "trends_by_K": {
            str(K): {"T1": equal_coverage(results).held, "T3": extent_decreases(results).held}
            for K, results in study.sweep.items()
        },
        "calibration": study.calibration,
        "house": summarize(study.house, search_spec(100)),
        "killian_court": study.killian.scores,
    }


def text_table_1(study: Section3) -> str:
    """Table 1 beside the paper's, and the verdicts, as text for the terminal."""
    lines = [
        f"Table 1 after {2 * SCANS_EACH} scans, {study.size.worlds} test worlds: mean "
        "[95 % interval], followed by the paper's value",
        f"{'search':<20}{'farthest point':>30}{'mean radius':>30}{'sigma':>30}{'% observed':>22}"
        f"{'efficiency, %':>22}",
    ]
    for search, row in study.table_1().items():
        cells = []
        for k, column in enumerate(TABLE_1_SCORES):
            paper = PAPER_TABLE_1.get(search)
            paper_value = f" {paper[k]:>6.2f}" if paper else " " * 7
            cells.append(f"{row[column]:.2f}{paper_value}")
        lines.append(
            f"{_search_label(search):<20}"
            + "".join(f"{cell:>30}" for cell in cells)
            + f"{format_interval(row['coverage'], 100):>22}"
            + f"{format_interval(row['efficiency'], 100, 1):>22}"
        )
    lines.append(
        "mean absolute relative deviation of the 18 numbers from the paper's: "
        f"{format_interval(study.deviation(), 100, 1)} %"
    )
    for name, trend in study.trends.items():
        p = "" if trend.p_value is None else f", p = {trend.p_value:.2g}"
        verdict = trend.verdict.replace("not held", "NOT held")
        lines.append(f"{name} {verdict}: {trend.question} ({trend.value:.3g}{p})")
    return "\n".join(lines)


def _draw_figures(study: Section3, out: Path) -> None:
    evaluations_by_label = {
        _search_label(search): result for search, result in study.searches.items()
    }
    figures.draw_world_and_map(
        study.figure_7, out / "figure7.png", "probabilistic map after 400 scans"
    )
    draw_coverage_curves(
        {RASTER: study.references[RASTER], **evaluations_by_label},
        2,
        out / "figure8.png",
        "% of environment observed",
    )
    figures.draw_sweep(study.sweep, out / "sensitivity.png")
    figures.draw_reliability(study.calibration, out / "reliability.png")
    figures.draw_world_and_map(
        study.house_snapshot, out / "house_map.png", "map by rating function, m = 100"
    )
    draw_coverage_curves(study.house, 2, out / "house_coverage.png", "real floor plan")
    save_frame(study.episode.frame, out / "render.png")
    killian = study.killian
    figures.draw_map(
        killian.probability, killian.sampled, killian.resolution, out / "killian_court.png"
    )


def _render_html(study: Section3, summary: dict[str, Any], out: Path) -> str:
    return render_template(
        "section3/report.html",
        out,
        study=study,
        summary=summary,
        field=summary.get("field"),
        field_columns=SCORE_COLUMNS,
        field_map_columns=MAP_COLUMNS,
        replay=(out / REPLAY_FILE).read_text(encoding="utf-8") if "field" in summary else "",
        table_1=study.table_1(),
        paper=PAPER_TABLE_1,
        columns=TABLE_1_SCORES,
        label=_search_label,
        deviation=study.deviation(),
        record=read_record(),
        verdicts=constant_verdicts(read_record()),
        default_size=SearchSize(),
        default_factors=PROFILE_FACTORS,
        scans=2 * SCANS_EACH,
        version=__version__,
        settings=json.dumps(summary["settings"], indent=2),
    )


def _table_1_csv(study: Section3) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    names = TABLE_1_COLUMNS
    header = [f"{name}{part}" for name in names for part in ("", "_low", "_high")]
    writer.writerow(["search", *header, *(f"paper_{name}" for name in TABLE_1_SCORES)])
    for search, row in study.table_1().items():
        values = [v for name in names for v in (row[name].estimate, row[name].low, row[name].high)]
        writer.writerow([_search_label(search), *values, *PAPER_TABLE_1.get(search, ("", "", ""))])
    return text.getvalue()


def _mean_scores(results: Mapping[Any, Evaluation]) -> dict[str, Any]:
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    return {
        _search_label(search): {
            column: bootstrap_mean(result.table[column], rng).as_dict()
            for column in (*TABLE_1_SCORES, "coverage")
        }
        for search, result in results.items()
    }


def _search_label(search: int | str) -> str:
    return f"m = {search}" if isinstance(search, int) else str(search)
