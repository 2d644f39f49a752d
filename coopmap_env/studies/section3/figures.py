"""Figures of the Section 3 report, as PNG and SVG files (extra ``report``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation
from coopmap_env.evaluation.figures import (
    COLORS,
    import_pyplot,
    label_curves,
    plot_bars,
    save_chart,
    save_figure,
)
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.evaluation.svg import add_readings
from coopmap_env.studies.section3.snapshots import EpisodeSnapshot

UNKNOWN_COLOR = (0.55, 0.63, 0.72)
"""Colour of cells that were never sampled; it cannot be mistaken for a gray level."""


def draw_world_and_map(snapshot: EpisodeSnapshot, path: Path, title: str) -> None:
    """Draw a world beside the team's map of it, with the paths of the cameras."""
    plt = import_pyplot()
    nx, ny = snapshot.truth.shape
    figure, axes = plt.subplots(
        1, 2, figsize=(11, 5.6 * ny / nx + 0.5), sharey=True, layout="constrained"
    )
    axes[0].imshow(~snapshot.truth.T, cmap="gray", origin="lower", extent=(0, nx, 0, ny))
    axes[0].set_title("(a) environment")
    axes[1].imshow(
        _map_image(snapshot.probability, snapshot.sampled), origin="lower", extent=(0, nx, 0, ny)
    )
    axes[1].set_title(f"(b) {title}")
    for robot, camera_path in enumerate(snapshot.paths):
        axes[1].plot(*camera_path.T, "-", color=COLORS[robot], linewidth=0.8)
        axes[1].plot(
            *camera_path[0], "o", color=COLORS[robot], markersize=6, label=f"robot {robot}, start"
        )
    figure.legend(
        *axes[1].get_legend_handles_labels(), loc="outside upper right", ncols=2, fontsize=8
    )
    for axis in axes:
        axis.set_xlabel("x, cells")
    axes[0].set_ylabel("y, cells")
    save_figure(figure, path)


def draw_map(
    probability: NDArray[np.float64], sampled: NDArray[np.bool_], resolution: float, path: Path
) -> None:
    """Draw one map alone, cropped to its sampled cells; the axes are in metres."""
    plt = import_pyplot()
    (x,), (y,) = np.nonzero(sampled.any(axis=1)), np.nonzero(sampled.any(axis=0))
    crop = np.s_[x[0] : x[-1] + 1, y[0] : y[-1] + 1]
    image = _map_image(probability[crop], sampled[crop])
    height, width = image.shape[:2]
    figure, axis = plt.subplots(figsize=(9, 9 * height / width + 0.5))
    extent = (0, width * resolution, 0, height * resolution)
    axis.imshow(image, origin="lower", extent=extent, interpolation="antialiased")
    axis.set_xlabel("x, metres")
    axis.set_ylabel("y, metres")
    save_figure(figure, path)


def draw_sweep(sweep: Mapping[float, Mapping[Any, Evaluation]], path: Path) -> None:
    """Draw coverage and sigma against K, one line for each search."""
    plt = import_pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(11, 3.8), layout="constrained")
    searches = list(next(iter(sweep.values())))
    for axis, column, scale, label in (
        (axes[0], "coverage", 100.0, "% of world observed"),
        (axes[1], "radius_std", 1.0, "sigma of observed space, cells"),
    ):
        axis.set(xlabel="K, nats per d**n", ylabel=label)
        for k, search in enumerate(searches):
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            means = [
                bootstrap_mean(scale * results[search].table[column], rng)
                for results in sweep.values()
            ]
            values = np.array([mean.estimate for mean in means])
            ends = [mean.low for mean in means], [mean.high for mean in means]
            name = f"m = {search}" if isinstance(search, int) else search
            plot_bars(axis, list(sweep), values, ends, label=name, color=COLORS[k])
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        label_curves(axis)
    save_chart(figure, path)


def draw_reliability(calibration: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Draw the fraction of occupied cells against the predicted probability, and the cells by bin.

    Bars are 95 % intervals over worlds, if the scores have them; see `reliability_intervals`.
    """
    plt = import_pyplot()
    figure, (axis, counts) = plt.subplots(1, 2, figsize=(11, 4.4), layout="constrained")
    axis.plot([0, 1], [0, 1], color="0.7", linewidth=1, label="_diagonal")
    axis.set(xlabel="predicted P(occupied)", ylabel="fraction of occupied cells")
    counts.set(xlabel="predicted P(occupied)", ylabel="cells in the bin", yscale="log", xlim=(0, 1))
    for k, (name, score) in enumerate(calibration.items()):
        curve, color, label = score["reliability"], COLORS[k], name.replace("_", " ")
        filled = [i for i, value in enumerate(curve["predicted"]) if value is not None]
        predicted, observed = (
            np.array([curve[part][i] for i in filled]) for part in ("predicted", "observed")
        )
        ends = [[curve[end][i] for i in filled] for end in ("low", "high") if end in curve]
        plot_bars(axis, predicted, observed, ends or None, label=label, color=color)
        n_bins = len(curve["counts"])
        width = 0.8 / len(calibration) / n_bins
        middles = [(i + 0.1) / n_bins + (k + 0.5) * width for i in filled]
        n_cells = [curve["counts"][i] for i in filled]
        counts.bar(middles, n_cells, width, color=color, label=label)
        add_readings(counts, label, predicted, n_cells, places=middles)
    axis.set_aspect("equal")
    axis.grid(alpha=0.3)
    label_curves(axis)
    counts.set_xticks(np.linspace(0, 1, 11))
    counts.grid(axis="y", alpha=0.3)
    figure.legend(
        *counts.get_legend_handles_labels(), loc="outside upper right", ncols=3, fontsize=8
    )
    save_chart(figure, path)


def _map_image(probability: NDArray[np.float64], sampled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Image (ny, nx, 3) of a map (nx, ny): occupied dark, free light, unknown in its own colour."""
    image = np.repeat((1.0 - probability)[..., None], 3, axis=2)
    image[~sampled] = UNKNOWN_COLOR
    return image.transpose(1, 0, 2)
