"""What figures of policies share; they are PNG files (extra ``report``)."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.comparison import Evaluation
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.evaluation.summary import BOOTSTRAP_SEED

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colour-blind-safe palette."""


def import_pyplot() -> Any:
    """Matplotlib's pyplot, which draws into files only."""
    import_optional("matplotlib", "report").use("Agg")
    return import_optional("matplotlib.pyplot", "report")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure and close it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    import_pyplot().close(figure)


def draw_coverage_curves(
    evaluations: Mapping[str, Evaluation],
    n_robots: int,
    path: Path,
    title: str,
    curve: str = "coverage",
    label: str = "% of world observed",
    dashed: str = "raster",
) -> None:
    """Draw a coverage curve of each policy against the scans of the team, with 95 % intervals.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        By policy; each has at least one world.
    n_robots : int
    path : Path
        Of the PNG.
    title : str
    curve : str
        Name of the curve in `Evaluation.curves`, a fraction.
    label : str
        Of the vertical axis.
    dashed : str
        Policy that is drawn with a dashed line.
    """
    figure, axis = import_pyplot().subplots(figsize=(7.5, 5))
    plot_curves(axis, evaluations, n_robots, curve, label, dashed)
    axis.set_title(title)
    axis.legend(fontsize=8)
    save_figure(figure, path)


def plot_curves(
    axis: Any,
    evaluations: Mapping[str, Evaluation],
    n_robots: int,
    curve: str,
    label: str,
    dashed: str = "raster",
) -> None:
    """Plot the curves of `draw_coverage_curves` on an axis."""
    for k, (name, evaluation) in enumerate(evaluations.items()):
        curves = 100 * evaluation.curves[curve]
        scans = n_robots * np.arange(curves.shape[1])
        color = COLORS[k % len(COLORS)]
        style = "--" if name == dashed else "-"
        axis.plot(scans, curves.mean(axis=0), style, color=color, label=name)
        if len(curves) > 1:
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            intervals = [bootstrap_mean(column, rng, n_resamples=500) for column in curves.T]
            axis.fill_between(
                scans,
                [interval.low for interval in intervals],
                [interval.high for interval in intervals],
                color=color,
                alpha=0.15,
                linewidth=0,
            )
    axis.set_xlabel("scans of the team")
    axis.set_ylabel(label)
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)


def save_frame(frame: NDArray[np.uint8], path: Path) -> None:
    """Write an image (H, W, 3) without axes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    import_pyplot().imsave(path, frame)
