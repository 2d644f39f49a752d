"""Figures of the benchmark study, as PNG and SVG files (extra ``report``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.evaluation.figures import (
    COLORS,
    import_pyplot,
    label_curves,
    plot_band,
    save_chart,
)
from coopmap_env.evaluation.svg import add_reading
from coopmap_env.studies.benchmark.methods import FAMILIES

AREA_LABELS = {
    "coverage_auc": "area under the coverage curve, %",
    "surface_coverage_auc": "area under the surface coverage curve, %",
}
CURVE_LABELS = {"planar": "% of the world observed", "field": "% of visible surface covered"}
STYLES = ("-", "--", ":", "-.")
"""Line styles of the methods of one family, in order."""
MARKERS = ("o", "s", "^", "D")
"""Markers of the methods of one family, in order."""
FAMILY_COLORS = dict(
    zip(
        FAMILIES,
        (COLORS[1], COLORS[0], COLORS[3], COLORS[2], COLORS[4], "#666666", "#111111"),
        strict=True,
    )
)


def draw_condition(condition: dict[str, Any], path: Path) -> None:
    """Draw curves and performance profiles of the plotted methods, and the AUC of all methods."""
    plt = import_pyplot()
    height = 1.2 + 0.24 * len(condition["methods"])
    figure = plt.figure(figsize=(12.5, 4.4 + height), layout="constrained")
    # a grid for each row: the long labels of the second one take no room from the first
    top, bottom = figure.add_gridspec(2, 1, height_ratios=(4.4, height))
    upper, lower = top.subgridspec(1, 2), bottom.subgridspec(1, 1)
    curves = figure.add_subplot(upper[0])
    profiles = figure.add_subplot(upper[1])
    areas = figure.add_subplot(lower[0])
    _draw_curves(curves, condition)
    _draw_profiles(profiles, condition)
    _draw_areas(areas, condition)
    save_chart(figure, path)


def _draw_curves(axis: Any, condition: dict[str, Any]) -> None:
    n_robots = condition["env_kwargs"]["n_robots"]
    axis.set(xlabel="scans of the team", ylabel=CURVE_LABELS[condition["env_name"]])
    for label, method, style in _plotted_methods(condition):
        scans = n_robots * np.arange(len(method["curve"]["estimate"]))
        _draw_band(axis, scans, method["curve"], style, label)
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    label_curves(axis)


def _draw_profiles(axis: Any, condition: dict[str, Any]) -> None:
    thresholds = 100 * np.array(condition["thresholds"])
    axis.set(
        xlabel=f"tau: {AREA_LABELS[condition['areas'][0]]}",
        ylabel="% of worlds above tau",
        xlim=(thresholds[0], thresholds[-1]),
        ylim=(0, 101),
    )
    for label, method, style in _plotted_methods(condition):
        _draw_band(axis, thresholds, method["profile"], style, label)
    axis.grid(alpha=0.3)
    # all profiles end at zero: their labels are where they cross half of the worlds
    label_curves(axis, at_height=50.0)


def _draw_band(axis: Any, at: Any, band: dict[str, Any], style: dict[str, Any], label: str) -> None:
    estimate, low, high = (100 * np.array(band[part]) for part in ("estimate", "low", "high"))
    plot_band(axis, at, estimate, (low, high), label, **style)


def _draw_areas(axis: Any, condition: dict[str, Any]) -> None:
    """Means with intervals, and means of single training runs, from the best method down."""
    area = condition["areas"][0]
    scores = {label: method["scores"][area] for label, method in condition["methods"].items()}
    order = sorted(scores, key=lambda label: scores[label]["mean"]["estimate"])
    axis.set(xlabel=AREA_LABELS[area], ylim=(-0.7, len(order) - 0.3))
    for row, label in enumerate(order):
        color = FAMILY_COLORS[condition["methods"][label]["family"]]
        _draw_interval(axis, row, scores[label]["mean"], color, label, scale=100)
        runs = scores[label]["runs"]
        if len(runs) > 1:
            axis.plot([100 * run for run in runs], [row - 0.3] * len(runs), "|", color=color)
    axis.set_yticks(range(len(order)), order, fontsize=9)
    axis.grid(axis="x", alpha=0.3)


def draw_generalization(conditions: list[dict[str, Any]], path: Path) -> None:
    """Draw ratios of AUC to that of the strongest planner with the same actions, by condition."""
    plt = import_pyplot()
    env_names = list(dict.fromkeys(condition["env_name"] for condition in conditions))
    n_intervals = max(
        sum(len(methods_with_baseline(c)) for c in conditions if c["env_name"] == env_name)
        for env_name in env_names
    )
    figure, axes = plt.subplots(
        1,
        len(env_names),
        figsize=(6.4 * len(env_names), 2.6 + 0.07 * n_intervals),
        squeeze=False,
        layout="constrained",
    )
    for axis, env_name in zip(axes[0], env_names, strict=True):
        _draw_ratios(
            axis, [condition for condition in conditions if condition["env_name"] == env_name]
        )
        axis.set_title("Planar-v1" if env_name == "planar" else "Field-v1", fontsize=10)
    handles = dict(
        pair
        for axis in axes[0]
        for pair in zip(*reversed(axis.get_legend_handles_labels()), strict=True)
    )
    figure.legend(
        handles.values(), handles, loc="outside upper center", ncols=len(env_names), fontsize=8
    )
    save_chart(figure, path)


def methods_with_baseline(condition: dict[str, Any]) -> dict[str, dict[str, Any]]:
    """Methods of a condition that are compared with another one, by label."""
    return {label: method for label, method in condition["methods"].items() if method["baseline"]}


def _draw_ratios(axis: Any, conditions: list[dict[str, Any]]) -> None:
    axis.axvline(1.0, color="black", linewidth=1)
    axis.set_xlabel("ratio of AUC to the strongest planner's")
    for row, condition in enumerate(reversed(conditions)):
        if row % 2:
            axis.axhspan(row - 0.5, row + 0.5, color="black", alpha=0.05, linewidth=0)
        area, compared = condition["areas"][0], methods_with_baseline(condition)
        n_drawn = dict.fromkeys(FAMILIES, 0)
        for number, (label, method) in enumerate(compared.items()):
            family = method["family"]
            ratio = method["comparisons"][method["baseline"]]["ratio"][area]
            y = row + 0.5 - (number + 0.5) / len(compared)
            marker = MARKERS[n_drawn[family] % len(MARKERS)]
            n_drawn[family] += 1
            _draw_interval(axis, y, ratio, FAMILY_COLORS[family], label, marker=marker)
    axis.set_yticks(
        range(len(conditions)), [condition["label"] for condition in reversed(conditions)]
    )
    axis.set_ylim(-0.5, len(conditions) - 0.5)
    axis.grid(axis="x", alpha=0.3)


def _draw_interval(
    axis: Any,
    row: float,
    interval: dict[str, float],
    color: str,
    label: str,
    scale: float = 1.0,
    marker: str = "o",
) -> None:
    at, low, high = (scale * interval[part] for part in ("estimate", "low", "high"))
    axis.plot([low, high], [row, row], "-", color=color, linewidth=2, alpha=0.6)
    axis.plot(at, row, marker, color=color, markersize=5, label=label)
    text = f"{axis.get_xlabel()}: {at:.4g} [{low:.4g}, {high:.4g}]"
    add_reading(axis, at, row, (label, text))


def _plotted_methods(condition: dict[str, Any]) -> list[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Label, results and line style of the plotted methods."""
    n_drawn = dict.fromkeys(FAMILIES, 0)
    out = []
    for label, method in condition["methods"].items():
        if method["plotted"]:
            family = method["family"]
            style = STYLES[n_drawn[family] % len(STYLES)]
            n_drawn[family] += 1
            out.append((label, method, {"linestyle": style, "color": FAMILY_COLORS[family]}))
    return out
