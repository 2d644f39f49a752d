"""Figures of the comparison of learned policies and planners, as PNG files (extra ``report``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.studies.benchmark.methods import FAMILIES, RATING
from coopmap_env.studies.common.figures import COLORS, import_pyplot, save_figure

AREA_LABELS = {
    "coverage_auc": "area under the curve of viewed share, %",
    "surface_coverage_auc": "area under the curve of covered surface, %",
}
CURVE_LABELS = {"planar": "% of the world viewed", "field": "% of reachable surface covered"}
STYLES = ("-", "--", ":", "-.")
"""Lines of the entries of one family, in their order."""
MARKERS = ("o", "s", "^", "D")
"""Dots of them, likewise."""
FAMILY_COLORS = dict(
    zip(FAMILIES, (COLORS[1], COLORS[0], COLORS[3], COLORS[2], "#666666"), strict=True)
)


def draw_condition(found: dict[str, Any], path: Path) -> None:
    """Curves and performance profiles of the main entries, areas under the curve of all."""
    plt = import_pyplot()
    figure = plt.figure(figsize=(10.5, 7.6), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(1.15, 1))
    curves = figure.add_subplot(grid[0, 0])
    profiles = figure.add_subplot(grid[1, 0])
    areas = figure.add_subplot(grid[:, 1])
    _draw_curves(curves, found)
    _draw_profiles(profiles, found)
    _draw_areas(areas, found)
    figure.legend(*curves.get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save_figure(figure, path)


def _draw_curves(axis: Any, found: dict[str, Any]) -> None:
    n_robots = found["arguments"]["n_robots"]
    for label, method, style in _plotted_methods(found):
        scans = n_robots * np.arange(len(method["curve"]["estimate"]))
        _draw_band(axis, scans, method["curve"], style, label)
    axis.set(xlabel="scans of the team", ylabel=CURVE_LABELS[found["world"]])
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)


def _draw_profiles(axis: Any, found: dict[str, Any]) -> None:
    thresholds = 100 * np.array(found["thresholds"])
    for label, method, style in _plotted_methods(found):
        _draw_band(axis, thresholds, method["profile"], style, label)
    axis.set(
        xlabel=f"tau: {AREA_LABELS[found['areas'][0]]}",
        ylabel="% of worlds above tau",
        xlim=(thresholds[0], thresholds[-1]),
        ylim=(0, 101),
    )
    axis.grid(alpha=0.3)


def _draw_band(axis: Any, at: Any, band: dict[str, Any], style: dict[str, Any], label: str) -> None:
    axis.plot(at, 100 * np.array(band["estimate"]), **style, label=label)
    low, high = (100 * np.array(band[end]) for end in ("low", "high"))
    axis.fill_between(at, low, high, color=style["color"], alpha=0.13, linewidth=0)


def _draw_areas(axis: Any, found: dict[str, Any]) -> None:
    """Means with intervals, and means of single training runs, from the best entry down."""
    area = found["areas"][0]
    scores = {label: method["scores"][area] for label, method in found["methods"].items()}
    order = sorted(scores, key=lambda label: scores[label]["mean"]["estimate"])
    for row, label in enumerate(order):
        color = FAMILY_COLORS[found["methods"][label]["family"]]
        _draw_interval(axis, row, scores[label]["mean"], color, scale=100)
        runs = scores[label]["runs"]
        if len(runs) > 1:
            axis.plot([100 * run for run in runs], [row - 0.3] * len(runs), "|", color=color)
    axis.set_yticks(range(len(order)), order, fontsize=9)
    axis.set(xlabel=AREA_LABELS[area], ylim=(-0.7, len(order) - 0.3))
    axis.grid(axis="x", alpha=0.3)


def draw_generalization(conditions: list[dict[str, Any]], path: Path) -> None:
    """Areas under the curve over the rating function's on as many candidates, by condition."""
    plt = import_pyplot()
    worlds = list(dict.fromkeys(found["world"] for found in conditions))
    figure, axes = plt.subplots(1, len(worlds), figsize=(5.6 * len(worlds), 4.4), squeeze=False)
    for axis, world in zip(axes[0], worlds, strict=True):
        _draw_ratios(axis, [found for found in conditions if found["world"] == world])
        axis.set_title("in the plane" if world == "planar" else "in the field", fontsize=10)
    axes[0, 0].legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path)


def methods_with_baseline(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Entries of a condition that are held against the rating function, by label."""
    return {
        label: method
        for label, method in found["methods"].items()
        if method["family"] != RATING and method["baseline"]
    }


def _draw_ratios(axis: Any, conditions: list[dict[str, Any]]) -> None:
    axis.axvline(1.0, color=FAMILY_COLORS[RATING], linewidth=1)
    for row, found in enumerate(reversed(conditions)):
        area, compared = found["areas"][0], methods_with_baseline(found)
        n_drawn = dict.fromkeys(FAMILIES, 0)
        for number, (label, method) in enumerate(compared.items()):
            family = method["family"]
            ratio = method["comparisons"][method["baseline"]]["ratio"][area]
            y = row + 0.22 * ((len(compared) - 1) / 2 - number)
            marker = MARKERS[n_drawn[family]]
            n_drawn[family] += 1
            name = label if row == 0 else None
            _draw_interval(axis, y, ratio, FAMILY_COLORS[family], label=name, marker=marker)
    axis.set_yticks(range(len(conditions)), [found["label"] for found in reversed(conditions)])
    axis.set_xlabel("area under the curve over the rating function's")
    axis.grid(axis="x", alpha=0.3)


def _draw_interval(
    axis: Any,
    row: float,
    interval: dict[str, float],
    color: str,
    scale: float = 1.0,
    label: str | None = None,
    marker: str = "o",
) -> None:
    at, low, high = (scale * interval[part] for part in ("estimate", "low", "high"))
    axis.plot([low, high], [row, row], "-", color=color, linewidth=2, alpha=0.6)
    axis.plot(at, row, marker, color=color, markersize=5, label=label)


def _plotted_methods(found: dict[str, Any]) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Label, entry and line of the main entries."""
    n_drawn = dict.fromkeys(FAMILIES, 0)
    out = []
    for label, method in found["methods"].items():
        if method["plotted"]:
            family = method["family"]
            style = STYLES[n_drawn[family] % len(STYLES)]
            n_drawn[family] += 1
            out.append((label, method, {"linestyle": style, "color": FAMILY_COLORS[family]}))
    return out
