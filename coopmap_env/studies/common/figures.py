"""Figures of the report, as PNG files (extra ``report``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.comparison import BOOTSTRAP_SEED, Evaluation
from coopmap_env.evaluation.statistics.bootstrap import bootstrap_mean
from coopmap_env.studies.section3.study import RASTER, EpisodeSnapshot

UNKNOWN_COLOR = (0.55, 0.63, 0.72)
"""Colour of cells that were never sampled: no gray level could be mistaken for it."""
COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colour-blind-safe palette."""


def import_pyplot() -> Any:
    """Matplotlib's pyplot, drawing into files."""
    import_optional("matplotlib", "report").use("Agg")
    return import_optional("matplotlib.pyplot", "report")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure and close it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    import_pyplot().close(figure)


def _map_image(probability: NDArray[np.float64], sampled: NDArray[np.bool_]) -> NDArray[np.float64]:
    """(ny, nx, 3) image of a map: occupied dark, free light, unknown in its own colour."""
    image = np.repeat((1.0 - probability)[..., None], 3, axis=2)
    image[~sampled] = UNKNOWN_COLOR
    return image.transpose(1, 0, 2)


def draw_world_and_map(snapshot: EpisodeSnapshot, path: Path, title: str) -> None:
    """A world beside the team's map of it, with the cameras' paths."""
    plt = import_pyplot()
    nx, ny = snapshot.truth.shape
    figure, axes = plt.subplots(1, 2, figsize=(11, 5.6 * ny / nx + 0.6), sharey=True)
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
    axes[1].legend(loc="upper right", fontsize=8)
    for axis in axes:
        axis.set_xlabel("x, cells")
    axes[0].set_ylabel("y, cells")
    save_figure(figure, path)


def draw_coverage_curves(
    evaluations: Mapping[str, Evaluation],
    n_robots: int,
    path: Path,
    title: str,
    curve: str = "coverage",
    label: str = "% of world viewed",
) -> None:
    """A share against scans of the team, such as that viewed: means with 95 % intervals."""
    plt = import_pyplot()
    figure, axis = plt.subplots(figsize=(7.5, 5))
    for k, (name, evaluation) in enumerate(evaluations.items()):
        curves = 100 * evaluation.curves[curve]
        scans = n_robots * np.arange(curves.shape[1])
        color = COLORS[k % len(COLORS)]
        style = "--" if name == RASTER else "-"
        axis.plot(scans, curves.mean(axis=0), style, color=color, label=name)
        if len(curves) > 1:
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            intervals = [bootstrap_mean(column, rng, n_resamples=500) for column in curves.T]
            axis.fill_between(
                scans,
                [band.low for band in intervals],
                [band.high for band in intervals],
                color=color,
                alpha=0.15,
                linewidth=0,
            )
    axis.set_xlabel("scans of the team")
    axis.set_ylabel(label)
    axis.set_title(title)
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save_figure(figure, path)


def draw_sweep(sweep: Mapping[float, Mapping[Any, Evaluation]], path: Path) -> None:
    """Viewed share and sigma against K, by search."""
    plt = import_pyplot()
    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2))
    searches = list(next(iter(sweep.values())))
    for axis, column, scale, label in (
        (axes[0], "coverage", 100.0, "% of world viewed"),
        (axes[1], "radius_std", 1.0, "sigma of viewed space, cells"),
    ):
        for k, search in enumerate(searches):
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            means = [
                bootstrap_mean(scale * results[search].table[column], rng)
                for results in sweep.values()
            ]
            values = np.array([mean.estimate for mean in means])
            errors = [
                values - [mean.low for mean in means],
                [mean.high for mean in means] - values,
            ]
            name = f"m = {search}" if isinstance(search, int) else search
            axis.errorbar(
                list(sweep), values, errors, color=COLORS[k], marker="o", capsize=3, label=name
            )
        axis.set_xlabel("K, nats per cell of motion")
        axis.set_ylabel(label)
        axis.set_ylim(bottom=0)
        axis.grid(alpha=0.3)
        axis.legend(fontsize=8)
    save_figure(figure, path)


def draw_reliability(calibration: Mapping[str, Mapping[str, Any]], path: Path) -> None:
    """Observed share of occupied cells against predicted probability."""
    plt = import_pyplot()
    figure, axis = plt.subplots(figsize=(5.2, 5))
    axis.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    for k, (name, score) in enumerate(calibration.items()):
        curve = score["reliability"]
        filled_bins = [i for i, value in enumerate(curve["predicted"]) if value is not None]
        axis.plot(
            [curve["predicted"][i] for i in filled_bins],
            [curve["observed"][i] for i in filled_bins],
            "o-",
            color=COLORS[k],
            label=f"{name.replace('_', ' ')}, log-loss {score['log_loss']:.4f}",
        )
    axis.set_xlabel("predicted P(occupied)")
    axis.set_ylabel("observed share of occupied cells")
    axis.set_aspect("equal")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8)
    save_figure(figure, path)


def save_frame(frame: NDArray[np.uint8], path: Path) -> None:
    """Save an image as it is."""
    path.parent.mkdir(parents=True, exist_ok=True)
    import_pyplot().imsave(path, frame)


def draw_map(
    probability: NDArray[np.float64], sampled: NDArray[np.bool_], resolution: float, path: Path
) -> None:
    """One map alone, axes in metres, cropped to what was sampled."""
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
