"""Files of the benchmark study: report.html, summary.json, table.md, episodes, figures."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.evaluation import write_episodes
from coopmap_env.studies.benchmark.families import SEARCH_POSES
from coopmap_env.studies.benchmark.figures import draw_condition, draw_generalization
from coopmap_env.studies.benchmark.motion_figure import draw_sweep
from coopmap_env.studies.benchmark.study import BenchmarkStudy, ConditionResult
from coopmap_env.studies.benchmark.summary import benchmark_summary
from coopmap_env.studies.benchmark.tables import (
    all_scores,
    benchmark_text,
    comparison_table,
    equal_motion_table,
    generalization_table,
    main_table,
    opponent_table,
    split_by_score,
    training_text,
    training_texts,
    verdict_table,
)
from coopmap_env.studies.benchmark.verdicts import ENV_LABELS, headlines
from coopmap_env.studies.common.pages import render_template


def write_benchmark_report(study: BenchmarkStudy, out: Path) -> dict[str, Any]:
    """Write all files into the folder `out`; return the summary."""
    out.mkdir(parents=True, exist_ok=True)
    summary = benchmark_summary(study)
    for part in summary["main"]:
        draw_condition(part, out / f"{part['env_name']}.png")
    for sweep in summary["sweeps"]:
        draw_sweep(sweep, out / f"motion_{sweep['env_name']}.png")
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
        training_text=training_text,
        training_texts=training_texts,
        search_poses=SEARCH_POSES,
        headlines=headlines(summary),
        env_labels=ENV_LABELS,
        table=main_table,
        scores=all_scores,
        comparisons=comparison_table,
        opponents=opponent_table,
        split_by_score=split_by_score,
        equal_motion=equal_motion_table,
        generalization=generalization_table(summary["generalization"]),
    )
    write_atomically(out / "report.html", page)
    return summary


def _write_csv(result: ConditionResult, path: Path) -> None:
    runs = {
        f"{method_result.method.label}; {spec}": evaluation
        for method_result in result.method_results
        for spec, evaluation in zip(
            method_result.method.policy_specs, method_result.runs, strict=True
        )
    }
    write_episodes(runs, path)
