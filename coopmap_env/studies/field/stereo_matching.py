"""A real stereo pair and a plain block matcher.

The pair is `stereo_motorcycle` of scikit-image (extra ``data``), of the Middlebury 2014 benchmark:
two rectified photographs, their calibration, and the true disparity measured by structured light.
The files are part of the wheel, so nothing is downloaded. The matcher compares blocks by the sum of
absolute differences, with a sub-pixel minimum and a left-right check.

D. Scharstein et al. 2014, "High-resolution stereo datasets with subpixel-accurate ground truth".
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

from coopmap_env.core.extras import import_optional

FOCAL_LENGTH, CENTER_X, CENTER_Y, DOFFS, BASELINE = 994.978, 311.193, 254.877, 31.086, 0.193001
"""Calibration as documented by scikit-image: pixels, and the baseline in metres."""
BLOCK = 9
"""Pixels: edge of the compared squares."""


@dataclass(frozen=True)
class StereoPair:
    """A rectified pair in gray values [0, 1] and the true disparity of the left image."""

    left: NDArray[np.float64]
    right: NDArray[np.float64]
    disparity: NDArray[np.float64]
    """Pixels, NaN where unknown; left (row, x) is right (row, x - disparity)."""


def load_motorcycle() -> StereoPair:
    """The pair of scikit-image.

    Raises
    ------
    ImportError
        With the pip command, if scikit-image is not installed.
    """
    left, right, disparity = import_optional("skimage.data", "data").stereo_motorcycle()
    disparity = np.where(np.isfinite(disparity), disparity, np.nan).astype(np.float64)
    return StereoPair(_gray(left), _gray(right), disparity)


def _gray(image: NDArray[np.uint8]) -> NDArray[np.float64]:
    return image @ np.array([0.299, 0.587, 0.114]) / 255.0


def match_blocks(
    left: NDArray[np.float64], right: NDArray[np.float64], n_disparities: int, block: int = BLOCK
) -> NDArray[np.float64]:
    """Disparity of the left image by block matching, NaN where it is not consistent.

    Parameters
    ----------
    left, right : ndarray, shape (rows, columns)
        Rectified gray images.
    n_disparities : int
        Disparities 0 ... n - 1 are searched, at least 3.
    block : int
        Edge of the compared squares, pixels.

    Raises
    ------
    ValueError
        If the images differ in shape or there is too little to search.
    """
    if left.ndim != 2 or left.shape != right.shape:
        raise ValueError(f"expected two gray images of one shape, got {left.shape}, {right.shape}")
    if not 3 <= n_disparities <= left.shape[1]:
        raise ValueError(f"n_disparities must lie in [3, {left.shape[1]}], got {n_disparities}")
    costs = np.full((n_disparities, *left.shape), np.inf, dtype=np.float32)
    best_of_right, lowest = np.zeros(left.shape, dtype=np.int64), np.full(left.shape, np.inf)
    for d in range(n_disparities):
        width = left.shape[1] - d
        difference = np.abs(left[:, d:] - right[:, :width]).astype(np.float32)
        costs[d, :, d:] = uniform_filter(difference, block)
        # column x of the left image is column x - d of the right one
        better = costs[d, :, d:] < lowest[:, :width]
        best_of_right[:, :width][better] = d
        lowest[:, :width][better] = costs[d, :, d:][better]
    best = costs.argmin(axis=0)
    rows, columns = np.indices(left.shape)
    best_back = best_of_right[rows, np.maximum(columns - best, 0)]
    inside = (best > 0) & (best < n_disparities - 1)
    middle = np.clip(best, 1, n_disparities - 2)
    a, b, c = (costs[middle + step, rows, columns] for step in (-1, 0, 1))
    # minimum of the two equally steep lines through three sums of absolute differences
    with np.errstate(invalid="ignore", divide="ignore"):
        offset = 0.5 * (a - c) / (np.maximum(a, c) - b)
    good = inside & (np.abs(best_back - best) <= 1) & np.isfinite(offset) & (np.abs(offset) <= 0.5)
    return np.where(good, middle + np.where(good, offset, 0.0), np.nan)


def texture(image: NDArray[np.float64], block: int = BLOCK) -> NDArray[np.float64]:
    """Mean absolute gradient along the row over the block around each pixel."""
    return np.asarray(uniform_filter(np.abs(np.gradient(image, axis=1)), block))


def depth_from_disparity(disparity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Depth along the optical axis, metres."""
    return FOCAL_LENGTH * BASELINE / (disparity + DOFFS)
