"""Figures of the localization study, as PNG and SVG files (extra ``report``)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.evaluation.figures import (
    COLORS,
    MAX_READINGS,
    import_pyplot,
    label_curves,
    plot_band,
    save_chart,
)
from coopmap_env.evaluation.svg import add_readings
from coopmap_env.studies.localization.estimator_comparison import ESTIMATORS, NOISE_FACTORS
from coopmap_env.studies.localization.study import LocalizationStudy


def draw_localization(search: dict[str, Any], study: LocalizationStudy, path: Path) -> None:
    """Draw the fraction of located robots against scans, and the errors of their bases."""
    plt = import_pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(10, 3.8))
    located_fractions = search["located_fraction"]
    scans = [int(k) for k in located_fractions]
    estimates = np.array([[100 * v for v in located_fractions[str(k)].values()] for k in scans])
    axes[0].set(xlabel="scans of the robot", ylabel="% of robots located", ylim=(0, 103))
    plot_band(
        axes[0], scans, estimates[:, 0], (estimates[:, 1], estimates[:, 2]), "located", COLORS[0],
        marker="o",
    )  # fmt: skip
    robots = [robot for result in study.searches for robot in result["robots"] if robot]
    axes[1].set(xlabel="base position error, cm", ylabel="base angle error, degrees")
    positions = [100 * robot["position"] for robot in robots]
    angles = [float(np.degrees(robot["angle"])) for robot in robots]
    axes[1].plot(positions, angles, "o", color=COLORS[0], markersize=3, alpha=0.6)
    add_readings(axes[1], "a robot", positions, angles)
    axes[1].set_xlim(left=0)
    axes[1].set_ylim(bottom=0)
    save_chart(figure, path)


def draw_pose_errors(study: LocalizationStudy, path: Path) -> None:
    """Draw the cumulative errors of camera poses before and after correction."""
    plt = import_pyplot()
    figure, axes = plt.subplots(1, 3, figsize=(12, 4.2), sharey=True, layout="constrained")
    scans = [scan for run in study.runs["fiducials"] for scan in run["scans"]]
    corrected = [scan for scan in scans if scan["corrected_directions"] > 0]
    lines = (
        ("encoders, all scans", scans, "encoders", COLORS[6], "-"),
        ("with predicted suspension, all scans", scans, "kinematic", COLORS[2], "-"),
        ("fiducials, all scans", scans, "estimated", COLORS[0], "-"),
        ("fiducials, all scans, smoothed", scans, "smoothed", COLORS[0], "--"),
        ("fiducials, corrected scans", corrected, "estimated", COLORS[1], "-"),
    )
    for axis, (name, label, scale) in zip(
        axes,
        (
            ("position", "camera position error, mm", 1e3),
            ("angle", "camera angle error, degrees", 180.0 / np.pi),
            ("point_displacement", "mean displacement of points, mm", 1e3),
        ),
        strict=True,
    ):
        axis.set(xlabel=label, ylabel="% of scans below", xscale="log")
        axis.tick_params(labelleft=True)  # pages show each axis alone
        axis.grid(alpha=0.3)
        for text, group, part, color, style in lines:
            values = np.array([scan[part][name] for scan in group], dtype=np.float64)
            values = np.sort(values[np.isfinite(values)]) * scale
            if len(values):
                percentages = 100 * (np.arange(len(values)) + 1) / len(values)
                axis.plot(values, percentages, style, color=color, label=text)
                n_shown = min(len(values), MAX_READINGS)
                some = np.linspace(0, len(values) - 1, n_shown).round().astype(int)
                add_readings(axis, text, values[some], percentages[some])
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    save_chart(figure, path)


def draw_pose_estimators(study: LocalizationStudy, path: Path) -> None:
    """Draw the median position error of each pose estimator against the noise."""
    plt = import_pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(11, 4), sharey=True, layout="constrained")
    for axis, (title, results) in zip(axes, study.pose_estimators.items(), strict=True):
        axis.set(xscale="log", yscale="log", title=title)
        axis.set(xlabel="noise, factor of the default", ylabel="median position error, mm")
        axis.tick_params(labelleft=True)  # pages show each axis alone
        for color, name in zip(COLORS, ("prediction", *ESTIMATORS), strict=True):
            style = "--" if name == "prediction" else "o-"
            errors = 1e3 * np.array(results[name]["position"])
            axis.plot(NOISE_FACTORS, errors, style, color=color, label=name, markersize=4)
            add_readings(axis, name, NOISE_FACTORS, errors)
        axis.set_xticks(NOISE_FACTORS, [f"{factor:g}" for factor in NOISE_FACTORS], minor=False)
        axis.minorticks_off()
    for axis in axes:
        label_curves(axis)
    save_chart(figure, path)
