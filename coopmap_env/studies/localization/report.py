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
from coopmap_env.studies.common.pages import fill_page
from coopmap_env.studies.localization.episodes import pictured_search
from coopmap_env.studies.localization.figures import (
    draw_errors,
    draw_identifications,
    draw_search,
)
from coopmap_env.studies.localization.pose_estimators import N_FIDUCIALS
from coopmap_env.studies.localization.study import (
    POLICY,
    SCANS_EACH,
    SEARCH_SCANS,
    SETTINGS,
    LocalizationStudy,
    interval,
    summary,
)

DEGREES = 180.0 / math.pi
PICTURED = 0
"""Seed of the search that is shown."""


def write_localization_report(study: LocalizationStudy, out: Path) -> dict[str, Any]:
    """Write everything into the folder `out`; the summary is returned too."""
    out.mkdir(parents=True, exist_ok=True)
    found = summary(study)
    draw_search(found["search"], study, out / "search.png")
    draw_errors(study, out / "errors.png")
    draw_identifications(study, out / "identifications.png")
    save_frame(pictured_search(PICTURED, "test", SEARCH_SCANS, POLICY), out / "episode.png")
    write_atomically(out / "summary.json", json.dumps(found, indent=2) + "\n")
    page = fill_page(
        "localization/report.html",
        out,
        {"scaled": _scaled, "percent": lambda values: _scaled(values, 100, 0)},
        found=found,
        s=found["search"],
        c=found["correction"],
        q=found["map_quality"],
        same=found["map_quality_of_the_same_looks"],
        nees=_nees,
        pair=_pair,
        degrees=DEGREES,
        scans=SCANS_EACH,
        search_scans=SEARCH_SCANS,
        settings_names=SETTINGS,
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
        f"{_scaled(s['located_share']['6'], 100, 0)} %, false matches {s['false_matches']}",
        f"  base error, median: {_scaled(s['position_error']['median'], 100)} cm, "
        f"{_scaled(s['angle_error']['median'], DEGREES)} degrees",
    ]
    for title in ("all_looks", "corrected_looks", "well_corrected_looks"):
        part = c[title]
        ratios = ", ".join(
            f"{name} {_scaled(part[name]['error_ratio_median'], 1)}"
            for name in ("position", "angle", "seen")
        )
        lines.append(f"{title.replace('_', ' ')} ({part['looks']}), error ratios: {ratios}")
    lines.append(f"{'camera poses':<14}{'F-score':>26}{'Chamfer, cm':>22}{'log-loss':>28}")
    lines += [
        f"{name:<14}{_scaled(q[name]['f_score'], 1, 4):>26}{_scaled(q[name]['chamfer'], 100):>22}"
        f"{_scaled(q[name]['log_loss'], 1, 4):>28}"
        for name in SETTINGS
    ]
    same = found["map_quality_of_the_same_looks"]["taken_minus"]["kinematic"]
    lines.append(
        f"the same looks, fiducials less kinematic: F {_scaled(same['f_score'], 1, 4)}, Chamfer "
        f"{_scaled(same['chamfer'], 100)} cm, log-loss {_scaled(same['log_loss'], 1, 4)}"
    )
    return "\n".join(lines)


def _scaled(values: dict[str, float], unit: float, digits: int = 2) -> str:
    """An interval in another unit."""
    low_high = interval(values)
    parts = [unit * v for v in (low_high.estimate, low_high.low, low_high.high)]
    return "{} [{}, {}]".format(*(f"{part:.{digits}f}" for part in parts))


def _nees(what: str, values: dict[str, Any]) -> str:
    """A sentence on normalised estimation errors squared."""
    if not values["looks"]:
        return ""
    low, high = values["band"]
    verdict = "within" if values["in_band"] else "outside of"
    return (
        f"{what} is {_scaled(values['mean'], 1)} on average, {verdict} the 95 % band "
        f"{low:.2f} to {high:.2f} of {values['looks']} independent normal errors of six numbers; "
        f"{100 * values['within_95_quantile']:.0f} % lie below the 95 % quantile of one."
    )


def _pair(values: dict[str, float]) -> str:
    return f"{1e3 * values['position']:.0f} mm and {DEGREES * values['angle']:.2f} degrees"
