"""What figures of policies share; they are PNG files, and SVG for pages (extra ``report``)."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import isotonic_regression

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.comparison import Evaluation
from coopmap_env.evaluation.statistics import bootstrap_mean
from coopmap_env.evaluation.summary import BOOTSTRAP_SEED
from coopmap_env.evaluation.svg import add_readings, save_svg

COLORS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")
"""Okabe and Ito's colour-blind-safe palette."""
LABEL_SIZE, LABEL_WIDTH = 8, 24
"""Points, and characters of a line, of the labels beside curves."""
MAX_READINGS = 24
"""Points of a curve whose values show under the pointer."""


def import_pyplot() -> Any:
    """Matplotlib's pyplot, which draws into files only."""
    import_optional("matplotlib", "report").use("Agg")
    return import_optional("matplotlib.pyplot", "report")


def save_figure(figure: Any, path: Path) -> None:
    """Write a figure and close it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110, bbox_inches="tight")
    import_pyplot().close(figure)


def save_chart(figure: Any, path: Path) -> None:
    """Write a figure as PNG, and beside it as the SVG that pages show; close it."""
    save_svg(figure, path.with_suffix(".svg"))
    save_figure(figure, path)


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
        Of the PNG; the SVG is beside it.
    title : str
    curve : str
        Name of the curve in `Evaluation.curves`, a fraction.
    label : str
        Of the vertical axis.
    dashed : str
        Policy that is drawn with a dashed line.
    """
    figure, axis = import_pyplot().subplots(figsize=(6, 4.2))
    plot_curves(axis, evaluations, n_robots, curve, label, dashed)
    axis.set_title(title, fontsize=10)
    label_curves(axis)
    save_chart(figure, path)


def plot_curves(
    axis: Any,
    evaluations: Mapping[str, Evaluation],
    n_robots: int,
    curve: str,
    label: str,
    dashed: str = "raster",
) -> None:
    """Plot the curves of `draw_coverage_curves` on an axis."""
    axis.set_xlabel("scans of the team")
    axis.set_ylabel(label)
    for k, (name, evaluation) in enumerate(evaluations.items()):
        curves = 100 * evaluation.curves[curve]
        scans = n_robots * np.arange(curves.shape[1])
        interval = None
        if len(curves) > 1:
            rng = np.random.default_rng(BOOTSTRAP_SEED)
            means = [bootstrap_mean(column, rng, n_resamples=500) for column in curves.T]
            interval = [mean.low for mean in means], [mean.high for mean in means]
        plot_band(
            axis,
            scans,
            curves.mean(axis=0),
            interval,
            label=name,
            color=COLORS[k % len(COLORS)],
            linestyle="--" if name == dashed else "-",
        )
    axis.set_xlim(left=0)
    axis.set_ylim(bottom=0)
    axis.grid(alpha=0.3)


def plot_band(
    axis: Any,
    x: ArrayLike,
    estimate: ArrayLike,
    interval: Sequence[ArrayLike] | None,
    label: str,
    color: str,
    **style: Any,
) -> None:
    """Plot a curve with the band of its interval, and its values under the pointer.

    Parameters
    ----------
    axis : Axes
        Of matplotlib; its labels are set.
    x, estimate : array_like
        The curve (n,).
    interval : two of array_like, optional
        Lower and upper end at each point (n,).
    label : str
    color : str
    **style
        Of the line.
    """
    at, values, *ends = _as_arrays(x, estimate, *(interval or ()))
    axis.plot(at, values, color=color, label=label, **style)
    some = np.unique(np.linspace(0, len(at) - 1, min(len(at), MAX_READINGS)).round().astype(int))
    if ends:
        axis.fill_between(at, *ends, color=color, alpha=0.15, linewidth=0)
    add_readings(axis, label, at[some], values[some], *(end[some] for end in ends))


def plot_bars(
    axis: Any,
    x: ArrayLike,
    estimate: ArrayLike,
    interval: Sequence[ArrayLike] | None,
    label: str,
    color: str,
    **style: Any,
) -> None:
    """Plot points with the bars of their intervals, joined, with values under the pointer.

    Parameters are those of `plot_band`.
    """
    at, values, *ends = _as_arrays(x, estimate, *(interval or ()))
    line = {"marker": "o", "markersize": 4, "linewidth": 1.3, **style}
    axis.plot(at, values, color=color, label=label, **line)
    if ends:
        axis.vlines(at, *ends, color=color, linewidth=1, alpha=0.7)
    add_readings(axis, label, at, values, *ends)


def _as_arrays(*values: ArrayLike) -> list[NDArray[np.float64]]:
    return [np.asarray(each, dtype=np.float64) for each in values]


def label_curves(axis: Any, right: float = 1.04, at_height: float | None = None) -> None:
    """Write the label of each curve beside its end, in its colour and right of the axis.

    Labels keep a distance from each other; a thin line leads from each to its curve.

    Parameters
    ----------
    axis : Axes
        Of matplotlib, with its curves and its limits.
    right : float
        Left end of the labels, as a fraction of the axis' width.
    at_height : float, optional
        For curves that fall and meet at their ends: lines lead to where they fall below this.
    """
    lines = [line for line in axis.lines if not line.get_label().startswith("_")]
    if not lines:
        return
    texts = [wrap_label(line.get_label()) for line in lines]
    ends = [_labelled_point(line, at_height) for line in lines]
    to_fraction = axis.transData + axis.transAxes.inverted()
    height = 72 * axis.bbox.height / axis.figure.dpi
    sizes = [1.25 * LABEL_SIZE * (text.count("\n") + 1) / height for text in texts]
    heights = spread([to_fraction.transform(end)[1] for end in ends], sizes)
    for line, text, end, y in zip(lines, texts, ends, heights, strict=True):
        axis.annotate(
            text,
            end,
            (right, y),
            textcoords="axes fraction",
            color=line.get_color(),
            fontsize=LABEL_SIZE,
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": line.get_color(), "lw": 0.6, "shrinkA": 1,
                        "relpos": (0, 0.5)},
        )  # fmt: skip


def _labelled_point(line: Any, at_height: float | None) -> tuple[float, float]:
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    below = np.flatnonzero(y < (-np.inf if at_height is None else at_height))
    k = below[0] if len(below) else -1
    return float(x[k]), float(y[k])


def wrap_label(text: str) -> str:
    """A label in lines of at most `LABEL_WIDTH` characters, broken at a policy's options."""
    with_spaces = re.sub(r"(?<=[:+])(?=\w)", "\0 ", text)
    lines = textwrap.wrap(with_spaces, LABEL_WIDTH, break_long_words=False, break_on_hyphens=False)
    return "\n".join(lines).replace("\0 ", "").replace("\0", "")


def spread(centers: Sequence[float], sizes: Sequence[float]) -> NDArray[np.float64]:
    """Centers of labels that do not overlap, nearest to the wanted ones (least squares).

    Parameters
    ----------
    centers : sequence of float
        Wanted ones (n,), as fractions of an axis.
    sizes : sequence of float
        Of the labels (n,), as such fractions. Labels stay within the axis if they fit.
    """
    order = np.argsort(centers, kind="stable")
    size = np.asarray(sizes, dtype=np.float64)[order]
    # without what the labels below take, the centers only have to be in order
    below = np.concatenate([[0.0], np.cumsum((size[1:] + size[:-1]) / 2)])
    free = isotonic_regression(np.asarray(centers, dtype=np.float64)[order] - below).x
    low, high = size[0] / 2, 1 - size[-1] / 2 - below[-1]
    if low <= high:
        free = np.clip(free, low, high)
    out = np.empty(len(order))
    out[order] = free + below
    return out


def save_frame(frame: NDArray[np.uint8], path: Path) -> None:
    """Write an image (H, W, 3) without axes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    import_pyplot().imsave(path, frame)
