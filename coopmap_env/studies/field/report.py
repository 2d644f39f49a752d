"""The 3-D part of the Section 3 report: figures, replay, tables."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from coopmap_env.core.settings import settings_to_dict
from coopmap_env.evaluation import summarize
from coopmap_env.evaluation.figures import draw_coverage_curves, save_frame
from coopmap_env.evaluation.replay import write_replay
from coopmap_env.evaluation.report import Column
from coopmap_env.studies.field import stereo
from coopmap_env.studies.field.study import SCANS_EACH, FieldStudy

REPLAY_FILE = "field_replay.html"
SCORE_COLUMNS = (
    Column("surface_coverage", "surface coverage, %", 100, 1),
    Column("surface_coverage_auc", "area under its curve, %", 100, 1),
    Column("target_coverage", "target coverage, %", 100, 1),
    Column("f_score", "F-score", 1, 3),
    Column("chamfer", "Chamfer distance, cm", 100, 2),
    Column("motion_distance", "motion, sum of d (Eq. 5)", 1, 1),
    Column("n_collisions", "collisions", 1, 2),
    Column("planning_time_ms", "decision, ms", 1, 2),
)
"""What a policy achieves and costs."""
MAP_COLUMNS = (
    Column("log_loss", "log-loss, nats", 1, 4),
    Column("log_loss_free", "of free voxels, nats", 1, 4),
    Column("log_loss_occupied", "of occupied voxels, nats", 1, 3),
    Column("brier_score", "Brier score", 1, 5),
    Column("false_free_fraction", "false free, %", 100, 1),
    Column("chi2_median", "surface: median χ² (honest: 0.455)", 1, 2),
    Column("chi2_tail", "surface: χ² > 3.84, % (honest: 5)", 100, 1),
)
"""How right the map's probabilities and surfaces are."""
TABLE_SCORES = tuple(column.score for column in (*SCORE_COLUMNS, *MAP_COLUMNS))
"""Columns of the report's tables."""


def write_field_figures(study: FieldStudy, out: Path) -> None:
    """Write the figures and the replay page into the folder `out`."""
    draw_coverage_curves(
        study.evaluations, 2, out / "field_surface.png", "test worksites",
        curve="surface_coverage", label="% of visible surface covered",
    )  # fmt: skip
    save_frame(study.frame, out / "field_render.png")
    stereo.draw_stereo(study.stereo, out / "stereo.png")
    write_replay(study.replay, out / REPLAY_FILE)


def field_summary(study: FieldStudy) -> dict[str, Any]:
    """All results as JSON values."""
    reference = next(iter(study.evaluations))
    return {
        "settings": settings_to_dict(study.settings),
        "n_robots": 2,
        "scans_each": SCANS_EACH,
        "scene": "worksite",
        "split": "test",
        "worlds": study.size.worlds,
        "policies": summarize(study.evaluations, reference),
        "octomap": study.octomap.as_dict(),
        "stereo": study.stereo.summary(),
    }


def field_text_table(study: FieldStudy) -> str:
    """The main scores as text for the terminal."""
    lines = [
        f"Field-v1 after {2 * SCANS_EACH} scans, {study.size.worlds} test worksites: means",
        f"{'policy':<50}{'surface':>9}{'its AUC':>9}{'F-score':>9}{'Chamfer':>9}{'log-loss':>10}"
        f"{'motion':>9}",
    ]
    for name, evaluation in study.evaluations.items():
        t = {score: values.mean() for score, values in evaluation.table.items()}
        lines.append(
            f"{name:<50}{100 * t['surface_coverage']:>8.1f}%"
            f"{100 * t['surface_coverage_auc']:>8.1f}%"
            f"{t['f_score']:>9.3f}{t['chamfer']:>7.3f} m{t['log_loss']:>10.4f}"
            f"{t['motion_distance']:>9.1f}"
        )
    return "\n".join(lines)
