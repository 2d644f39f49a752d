"""The localization study's files: report.html, summary.json, figures, and text to print."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from coopmap_env.core.files import write_atomically
from coopmap_env.core.serial import settings_to_dict
from coopmap_env.envs.field import FieldSettings
from coopmap_env.studies.common.figures import save_frame
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.localization.episodes import render_search
from coopmap_env.studies.localization.figures import (
    draw_localization,
    draw_pose_errors,
    draw_pose_estimators,
)
from coopmap_env.studies.localization.pose_estimators import N_FIDUCIALS
from coopmap_env.studies.localization.study import (
    CORRECTION_MODES,
    POLICY,
    SCANS_EACH,
    SEARCH_SCANS,
    LocalizationStudy,
    interval_from_dict,
    summary,
)

DEGREES = 180.0 / math.pi
RENDERED_SEED = 0
"""Seed of the search that is shown."""


def write_localization_report(study: LocalizationStudy, out: Path) -> dict[str, Any]:
    """Write everything into the folder `out`; the summary is returned too."""
    out.mkdir(parents=True, exist_ok=True)
    found = summary(study)
    draw_localization(found["search"], study, out / "search.png")
    draw_pose_errors(study, out / "errors.png")
    draw_pose_estimators(study, out / "identifications.png")
    save_frame(render_search(RENDERED_SEED, "test", SEARCH_SCANS, POLICY), out / "episode.png")
    write_atomically(out / "summary.json", json.dumps(found, indent=2) + "\n")
    page = render_template(
        "localization/report.html",
        out,
        {"scaled": format_interval, "percent": lambda values: format_interval(values, 100, 0)},
        found=found,
        s=found["search"],
        c=found["correction"],
        q=found["map_quality"],
        same_scans_quality=found["map_quality_same_scans"],
        nees=_nees,
        pair=_pair,
        degrees=DEGREES,
        scans=SCANS_EACH,
        search_scans=SEARCH_SCANS,
        correction_modes=CORRECTION_MODES,
        n_fiducials=N_FIDUCIALS,
        settings=json.dumps(settings_to_dict(FieldSettings()), indent=2),
    )
    write_atomically(out / "report.html", page)
    return found


def text_summary(found: dict[str, Any]) -> str:
    """The main figures, for the terminal."""
    s, c, q = found["search"], found["correction"], found["map_quality"]
    lines = [
        f"search: {s['robots']} robots, located within 6 scans "
        f"{format_interval(s['located_fraction']['6'], 100, 0)} %, false matches {s['false_matches']}",
        f"  base error, median: {format_interval(s['position_error']['median'], 100)} cm, "
        f"{format_interval(s['angle_error']['median'], DEGREES)} degrees",
    ]
    for title in ("all_scans", "corrected_scans", "well_corrected_scans"):
        part = c[title]
        ratios = ", ".join(
            f"{name} {format_interval(part[name]['error_ratio_median'], 1)}"
            for name in ("position", "angle", "point_displacement")
        )
        lines.append(f"{title.replace('_', ' ')} ({part['scans']}), error ratios: {ratios}")
    lines.append(f"{'camera poses':<14}{'F-score':>26}{'Chamfer, cm':>22}{'log-loss':>28}")
    lines += [
        f"{name:<14}{format_interval(q[name]['f_score'], 1, 4):>26}{format_interval(q[name]['chamfer'], 100):>22}"
        f"{format_interval(q[name]['log_loss'], 1, 4):>28}"
        for name in CORRECTION_MODES
    ]
    same_scans_quality = found["map_quality_same_scans"]["estimated_minus"]["kinematic"]
    lines.append(
        f"the same looks, fiducials less kinematic: F {format_interval(same_scans_quality['f_score'], 1, 4)}, Chamfer "
        f"{format_interval(same_scans_quality['chamfer'], 100)} cm, log-loss {format_interval(same_scans_quality['log_loss'], 1, 4)}"
    )
    return "\n".join(lines)


def format_interval(values: dict[str, float], unit: float, digits: int = 2) -> str:
    """An interval in another unit."""
    low_high = interval_from_dict(values)
    parts = [unit * v for v in (low_high.estimate, low_high.low, low_high.high)]
    return "{} [{}, {}]".format(*(f"{part:.{digits}f}" for part in parts))


def _nees(what: str, values: dict[str, Any]) -> str:
    """A sentence on normalised estimation errors squared."""
    if not values["scans"]:
        return ""
    low, high = values["band"]
    verdict = "within" if values["in_band"] else "outside of"
    return (
        f"{what} is {format_interval(values['mean'], 1)} on average, {verdict} the 95 % band "
        f"{low:.2f} to {high:.2f} of {values['scans']} independent normal errors of six numbers; "
        f"{100 * values['within_95_quantile']:.0f} % lie below the 95 % quantile of one."
    )


def _pair(values: dict[str, float]) -> str:
    return f"{1e3 * values['position']:.0f} mm and {DEGREES * values['angle']:.2f} degrees"
