"""Eq. 1 on a real stereo pair: how the depth error grows with distance.

The observations come from the block matcher of `stereo_matching`, as those of a robot's stereo
camera would. Depth is Z = f B / (disparity + doffs). So an error of the disparity that does not
depend on the distance is an error of Z that grows with Z squared. This module measures whether the
matcher's error does.

In one photograph, distance and objects are confounded: most of its bare floor lies at 3 m, and
blocks without texture match anything. Therefore the law is fitted to textured blocks, the only ones
that a stereo camera reports (n = 1.9); the fit to all blocks is given beside it (n = 1.5). Filters
by matching error and by depth edges gave 1.1 to 1.6. The result is consistent with n = 2 where
there is texture; it is no proof.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.evaluation.figures import import_pyplot
from coopmap_env.evaluation.statistics import Interval, percentile_bounds
from coopmap_env.mapping import BeamModel, OccupancyMap, VoxelGrid
from coopmap_env.sensing import RangeNoise, Scan
from coopmap_env.studies.field.stereo_matching import (
    CENTER_X,
    CENTER_Y,
    FOCAL_LENGTH,
    StereoPair,
    depth_from_disparity,
    load_motorcycle,
    match_blocks,
    texture,
)

TILE = 50
"""Pixels: errors of neighbouring pixels are correlated, so the bootstrap draws whole tiles."""
N_DISPARITIES = 70
"""Pixels: the true ones reach 60."""
MIN_TEXTURE = 0.01
"""Minimum of the mean gradient along the row over a block, in full scale per pixel. Without it the
fit gives n = 1.54 [1.15, 2.05]; with 0.005 1.51, 0.01 1.89, 0.02 1.91, 0.03 1.93."""
STRIDE = 3
"""Pixels between two that the law is fitted to: blocks of neighbours are mostly the same."""
MAD_TO_SIGMA = 1.4826
"""Ratio of the standard deviation to the median absolute deviation of a normal distribution. Gross
errors of the block matcher, which Eq. 1 does not describe, hardly change a median."""


@dataclass(frozen=True)
class ErrorLaw:
    """sigma(d) = S d**n, fitted to the depth errors by distance."""

    distances: NDArray[np.float64]
    """Median depth of each bin, metres."""
    sigmas: NDArray[np.float64]
    """Robust standard deviation of its depth errors, metres."""
    counts: NDArray[np.int64]
    """Its pixels."""
    intrinsic: float
    """S, metres at 1 m."""
    exponent: Interval
    """n, with its 95 % bootstrap interval over image tiles."""
    intrinsic_at_2: float
    """S of the law with n = 2, which is what `RangeNoise` has by default."""


@dataclass(frozen=True)
class StereoResult:
    """Results for the report and the figure."""

    pair: StereoPair
    matched: NDArray[np.float64]
    """The matcher's disparity, NaN where there is none or the block has no texture."""
    bad_fraction: float
    """Fraction of its disparities with an error of more than two pixels."""
    law: ErrorLaw
    law_all_blocks: ErrorLaw
    """The law fitted to all blocks, those without texture included."""
    map: OccupancyMap

    def summary(self) -> dict[str, Any]:
        """The numbers, as JSON values."""
        return {
            "matched_fraction": float(np.isfinite(self.matched).mean()),
            "bad_fraction": self.bad_fraction,
            "exponent": self.law.exponent.as_dict(),
            "exponent_all_blocks": self.law_all_blocks.exponent.as_dict(),
            "intrinsic": self.law.intrinsic, "intrinsic_at_2": self.law.intrinsic_at_2,
            "cells": int(self.map.sampled.sum()), "surfaces": len(self.map.surfaces()[0]),
        }  # fmt: skip


def fit_error_law(
    depth: NDArray[np.float64],
    error: NDArray[np.float64],
    rng: np.random.Generator,
    n_bins: int = 8,
    n_resamples: int = 200,
) -> ErrorLaw:
    """Fit sigma = S d**n by a line through the logarithms, one point for each distance bin.

    Parameters
    ----------
    depth, error : ndarray, shape (rows, columns)
        True depth and the error of the observed one, metres; NaN where there is none.
    rng : numpy.random.Generator
        For the bootstrap.

    Raises
    ------
    ValueError
        If there are too few errors for the bins.
    """
    valid = np.zeros(depth.shape, dtype=np.bool_)
    valid[::STRIDE, ::STRIDE] = np.isfinite(depth + error)[::STRIDE, ::STRIDE]
    d, e = depth[valid], error[valid]
    if len(d) < 50 * n_bins:
        raise ValueError(f"{len(d)} errors are too few for {n_bins} bins of at least 50")
    edges = np.quantile(d, np.linspace(0, 1, n_bins + 1))
    bins = np.clip(np.searchsorted(edges, d, side="right") - 1, 0, n_bins - 1)
    rows, columns = np.nonzero(valid)
    tiles = rows // TILE * (depth.shape[1] // TILE + 1) + columns // TILE
    members = [np.flatnonzero(tiles == tile) for tile in np.unique(tiles)]
    distances, sigmas = _bin_statistics(d, e, bins, n_bins)
    n, log_s = _fit_line(distances, sigmas)
    exponents = []
    for _ in range(n_resamples):
        chosen = np.concatenate([members[k] for k in rng.integers(len(members), size=len(members))])
        exponents.append(_fit_line(*_bin_statistics(d[chosen], e[chosen], bins[chosen], n_bins))[0])
    low, high = percentile_bounds(exponents)
    return ErrorLaw(
        distances, sigmas, np.bincount(bins, minlength=n_bins), float(np.exp(log_s)),
        Interval(n, float(low), float(high)),
        float(np.exp(np.mean(np.log(sigmas / distances**2)))),
    )  # fmt: skip


def _bin_statistics(
    d: NDArray[np.float64], e: NDArray[np.float64], bins: NDArray[np.int64], n_bins: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Median distance and robust sigma of each bin that has pixels."""
    rows = [(d[bins == b], e[bins == b]) for b in range(n_bins) if (bins == b).any()]
    sigmas = [MAD_TO_SIGMA * np.median(np.abs(errors - np.median(errors))) for _, errors in rows]
    return np.array([np.median(distances) for distances, _ in rows]), np.array(sigmas)


def _fit_line(distances: NDArray[np.float64], sigmas: NDArray[np.float64]) -> tuple[float, float]:
    """Slope and height at 1 m of the line through the logarithms."""
    slope, height = np.polyfit(np.log(distances), np.log(sigmas), 1)
    return float(slope), float(height)


def to_scan(disparity: NDArray[np.float64], noise: RangeNoise, step: int = 3) -> Scan:
    """Every `step`-th pixel as a beam of a camera at the world's origin, x forward, z up.

    The covariance is Eq. 1 at the point's depth: along x from the disparity, across it with the
    lateral factor.
    """
    keep = np.zeros(disparity.shape, dtype=np.bool_)
    keep[::step, ::step] = np.isfinite(disparity[::step, ::step])
    rows, columns = np.nonzero(keep)
    z = depth_from_disparity(disparity[keep])
    y, up = (CENTER_X - columns) / FOCAL_LENGTH, (CENTER_Y - rows) / FOCAL_LENGTH
    points = np.stack([z, y * z, up * z], axis=-1)
    covariances = np.zeros((len(z), 3, 3))
    covariances[:, range(3), range(3)] = noise.standard_deviations(z, 3) ** 2
    return Scan(np.zeros(3), points, covariances, np.ones(len(z), dtype=np.bool_))


def run_stereo(rng: np.random.Generator, resolution: float = 0.04) -> StereoResult:
    """Match, compare with the truth, fit the law, and fuse the matched depths into a 3-D map."""
    pair = load_motorcycle()
    depth = depth_from_disparity(pair.disparity)
    all_blocks = match_blocks(pair.left, pair.right, N_DISPARITIES)
    matched = np.where(texture(pair.left) > MIN_TEXTURE, all_blocks, np.nan)
    laws = [
        fit_error_law(depth, depth_from_disparity(found) - depth, rng)
        for found in (matched, all_blocks)
    ]
    disparity_error = np.abs(matched - pair.disparity)
    bad = float((disparity_error > 2).sum() / np.isfinite(disparity_error).sum())
    grid = VoxelGrid(
        tuple(round(length / resolution) for length in (5.6, 4.4, 3.0)), resolution,
        (-0.2, -2.4, -1.5),
    )  # fmt: skip
    # surfaces lie inside of cells; the model corrects half of the frame's own gross errors
    map_ = OccupancyMap(grid, BeamModel(0.1, 0.9, "partial"))
    map_.integrate(to_scan(matched, RangeNoise(intrinsic=laws[0].intrinsic_at_2)))
    return StereoResult(pair, matched, bad, laws[0], laws[1], map_)


def draw_stereo(result: StereoResult, path: Path) -> None:
    """Draw the photograph, the matched depth, the error law and the map (extra ``report``)."""
    plt = import_pyplot()
    figure, axes = plt.subplots(2, 2, figsize=(12, 9))
    axes[0, 0].imshow(result.pair.left, cmap="gray")
    axes[0, 0].set_title("left image")
    shown = axes[0, 1].imshow(depth_from_disparity(result.matched), cmap="viridis", vmin=2, vmax=5)
    figure.colorbar(shown, ax=axes[0, 1], label="depth, m", shrink=0.7)
    axes[0, 1].set_title("depth by block matching; white: none")
    _draw_law(axes[1, 0], result.law)
    _draw_map(axes[1, 1], result.map)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _draw_law(axis: Any, law: ErrorLaw) -> None:
    """Measured standard deviations and both lines, in millimetres."""
    axis.loglog(law.distances, 1e3 * law.sigmas, "o", color="#0072B2", label="measured")
    d = np.linspace(law.distances[0], law.distances[-1], 50)
    label = f"fit: n = {law.exponent}"
    axis.loglog(d, 1e3 * law.intrinsic * d**law.exponent.estimate, color="#D55E00", label=label)
    label = f"n = 2, S = {law.intrinsic_at_2:.4f} per m"
    axis.loglog(d, 1e3 * law.intrinsic_at_2 * d**2, "--", color="0.4", label=label)
    for set_ticks, ticks in (
        (axis.set_xticks, (2, 2.5, 3, 4, 5)),
        (axis.set_yticks, (5, 10, 20, 40)),
    ):
        set_ticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.minorticks_off()
    axis.set_xlabel("distance, m")
    axis.set_ylabel("standard deviation of depth, mm")
    axis.grid(alpha=0.3)
    axis.legend(fontsize=8, loc="lower right")  # the errors grow from the lower left


def _draw_map(axis: Any, map_: OccupancyMap) -> None:
    """Surface means of the occupied voxels from the camera, the nearest on top."""
    cells, means, _ = map_.surfaces()
    x, y, z = means[map_.probability.ravel()[cells] > 0.5].T
    order = np.argsort(-x)
    axis.scatter(-y[order], z[order], c=x[order], s=3, cmap="viridis", vmin=2, vmax=5, linewidths=0)
    axis.set_aspect("equal")
    axis.set_xlabel("to the right, m")
    axis.set_ylabel("up, m")
    axis.set_title(f"map: surface means of {len(x)} occupied voxels, by depth")
