"""Files of the localization study: report.html, summary.json, figures; and its text."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.envs.field import FieldSettings
from coopmap_env.evaluation.figures import save_frame
from coopmap_env.evaluation.tables import format_interval
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.localization.episodes import render_search
from coopmap_env.studies.localization.estimator_comparison import N_FIDUCIALS
from coopmap_env.studies.localization.figures import (
    draw_localization,
    draw_pose_errors,
    draw_pose_estimators,
)
from coopmap_env.studies.localization.map_quality import ESTIMATES
from coopmap_env.studies.localization.study import (
    CORRECTION_MODES,
    POLICY,
    SCANS_EACH,
    SEARCH_SCANS,
    LocalizationStudy,
)
from coopmap_env.studies.localization.summary import localization_summary

DEGREES = 180.0 / math.pi
KIND_LABELS = {
    "encoders": "encoders",
    "kinematic": "predicted suspension",
    "estimated": "fiducials, when fused",
    "smoothed": "fiducials, by all scans",
    "exact": "exact",
}
"""Of each kind of camera pose; see `RecordedPoses`."""
RENDERED_SEED = 0
"""Seed of the search in the report's picture."""


def write_localization_report(study: LocalizationStudy, out: Path) -> dict[str, Any]:
    """Write all files into the folder `out`; return the summary."""
    out.mkdir(parents=True, exist_ok=True)
    summary = localization_summary(study)
    draw_localization(summary["search"], study, out / "search.png")
    draw_pose_errors(study, out / "errors.png")
    draw_pose_estimators(study, out / "pose_estimators.png")
    save_frame(render_search(RENDERED_SEED, "test", SEARCH_SCANS, POLICY), out / "episode.png")
    write_atomically(out / "summary.json", json.dumps(summary, indent=2) + "\n")
    page = render_template(
        "localization/report.html",
        out,
        summary=summary,
        search=summary["search"],
        correction=summary["correction"],
        quality=summary["map_quality"],
        same_scans_quality=summary["map_quality_same_scans"],
        nees=_nees,
        pair=_pair,
        degrees=DEGREES,
        scans_each=SCANS_EACH,
        search_scans=SEARCH_SCANS,
        correction_modes=CORRECTION_MODES,
        estimates=ESTIMATES,
        kind_labels=KIND_LABELS,
        n_fiducials=N_FIDUCIALS,
        settings=json.dumps(settings_to_dict(FieldSettings()), indent=2),
    )
    write_atomically(out / "report.html", page)
    return summary


def localization_text(summary: dict[str, Any]) -> str:
    """The main results as text for the terminal."""
    search, correction = summary["search"], summary["correction"]
    located = format_interval(search["located_fraction"]["6"], 100, 0)
    position = format_interval(search["position_error"]["median"], 100)
    angle = format_interval(search["angle_error"]["median"], DEGREES)
    lines = [
        f"search: {search['robots']} robots, located within 6 scans {located} %, "
        f"false matches {search['false_matches']}",
        f"  base error, median: {position} cm, {angle} degrees",
    ]
    for title in ("all_scans", "corrected_scans", "well_corrected_scans"):
        part = correction[title]
        lines.append(f"{title.replace('_', ' ')} ({part['scans']}), position error, mm, and ratio:")
        lines += [
            f"  {KIND_LABELS[kind]:<26}{format_interval(part['position'][kind]['median'], 1e3):>20}"
            f"{format_interval(part['position'][kind]['error_ratio']):>20}"
            for kind in ESTIMATES
        ]
    lines.append(f"{'camera poses':<14}{'F-score':>26}{'Chamfer, cm':>22}{'log-loss':>28}")
    for name in CORRECTION_MODES:
        f_score, chamfer, log_loss = _quality(summary["map_quality"][name])
        lines.append(f"{name:<14}{f_score:>26}{chamfer:>22}{log_loss:>28}")
    return "\n".join([*lines, *summary["verdicts"]])


def _quality(scores: dict[str, dict[str, float]]) -> tuple[str, str, str]:
    """F-score, Chamfer distance (cm) and log-loss as text."""
    return (
        format_interval(scores["f_score"], digits=4),
        format_interval(scores["chamfer"], 100),
        format_interval(scores["log_loss"], digits=4),
    )


def _nees(what: str, values: dict[str, Any]) -> str:
    """A sentence on a normalised estimation error squared (NEES)."""
    if not values["scans"]:
        return ""
    low, high = values["band"]
    verdict = "within" if values["in_band"] else "outside"
    return (
        f"{what} is {format_interval(values['mean'])} on average, {verdict} the 95 % band "
        f"{low:.2f} to {high:.2f} of {values['scans']} independent normal errors of six numbers; "
        f"{100 * values['within_95_quantile']:.0f} % are below the 95 % quantile of a single error."
    )


def _pair(values: dict[str, float]) -> str:
    return f"{1e3 * values['position']:.0f} mm and {DEGREES * values['angle']:.2f} degrees"
