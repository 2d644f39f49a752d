"""Score against motion: the sweep of each family and the learned policies, as PNG and SVG files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from coopmap_env.evaluation.figures import import_pyplot, save_chart
from coopmap_env.evaluation.svg import add_readings
from coopmap_env.studies.benchmark.figures import FAMILY_COLORS
from coopmap_env.studies.benchmark.methods import LEARNED, MOTION
from coopmap_env.studies.benchmark.tables import training_text
from coopmap_env.studies.benchmark.verdicts import ENV_LABELS, SCORE_TEXTS

LEARNED_MARKERS = ("*", "P", "X", "D")
"""Markers of the learned policies, in order."""


def draw_sweep(sweep: dict[str, Any], path: Path) -> None:
    """Draw each score against motion, one panel a score.

    Dots are independent planners, triangles sequential ones; a line joins those of a family that
    training worlds have chosen as the opponents at equal motion.
    """
    plt = import_pyplot()
    scores = sweep["scores"]
    figure, axes = plt.subplots(
        1, len(scores), figsize=(5.2 * len(scores), 4.8), squeeze=False, layout="constrained"
    )
    where = f"{ENV_LABELS[sweep['env_name']]}, {sweep['worlds']} worlds"
    for axis, score in zip(axes[0], scores, strict=True):
        name, scale, unit = SCORE_TEXTS[score]
        axis.set(xlabel="motion of the team, sum of d (Eq. 5)", ylabel=f"{name}, {unit}")
        axis.set_title(f"{where}; lines: by {training_text(sweep)}", fontsize=9)
        _draw_planners(axis, sweep, score, scale)
        _draw_learned(axis, sweep, score, scale)
        axis.grid(alpha=0.3)
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside upper center", ncols=3, fontsize=8
    )
    save_chart(figure, path)


def _draw_planners(axis: Any, sweep: dict[str, Any], score: str, scale: float) -> None:
    for family, color in FAMILY_COLORS.items():
        members = {name: m for name, m in sweep["methods"].items() if m["family"] == family}
        if not members or family == LEARNED:
            continue
        line = [sweep["methods"][label] for label in sweep["lines"][score].get(family, ())]
        line.sort(key=lambda method: float(method[MOTION]["estimate"]))
        axis.plot(*_points(line, score, scale), "-", color=color, linewidth=1.2, label=family)
        for is_sequential, marker in ((False, "o"), (True, "^")):
            chosen = [
                method
                for method in members.values()
                if ("sequential" in method["policies"][0]) == is_sequential
            ]
            axis.plot(*_points(chosen, score, scale), marker, color=color, markersize=4)
        for name, method in members.items():
            low, high = ([scale * method[score][end]] for end in ("low", "high"))
            add_readings(axis, name, *_points([method], score, scale), low, high)


def _draw_learned(axis: Any, sweep: dict[str, Any], score: str, scale: float) -> None:
    learned = {name: m for name, m in sweep["methods"].items() if m["family"] == LEARNED}
    for (label, method), marker in zip(learned.items(), LEARNED_MARKERS, strict=False):
        (motion,), (value,) = _points([method], score, scale)
        bars = {
            f"{axis_name}err": [[at - scaled * band["low"]], [scaled * band["high"] - at]]
            for axis_name, at, scaled, band in (
                ("x", motion, 1.0, method[MOTION]),
                ("y", value, scale, method[score]),
            )
        }
        axis.errorbar(
            motion,
            value,
            fmt=marker,
            color=FAMILY_COLORS[LEARNED],
            markersize=9,
            label=label,
            **bars,
        )
        low, high = ([scale * method[score][end]] for end in ("low", "high"))
        add_readings(axis, label, [motion], [value], low, high)


def _points(
    methods: list[dict[str, Any]], score: str, scale: float
) -> tuple[list[float], list[float]]:
    """Motions and scores."""
    return (
        [method[MOTION]["estimate"] for method in methods],
        [scale * method[score]["estimate"] for method in methods],
    )
