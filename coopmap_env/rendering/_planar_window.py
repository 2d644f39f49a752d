"""Which part of a planar map a panel shows, and where its cells are on it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

ZOOM_RATIO = 1.25
"""Cells become this much larger from one zoom to the next: few zooms, so that films rarely jump."""
STEPS_PER_WINDOW = 8
"""A window moves by this fraction of its side, for the same reason."""


@dataclass(frozen=True)
class PlanarWindow:
    """A rectangle of a map on a panel of fixed size; pixels are counted from the map's top left."""

    shape: tuple[int, int]
    """Cells of the map along x and y."""
    scale: int
    """Pixels of a cell."""
    left: int
    """First column of pixels of the map that is shown."""
    top: int
    """First row."""
    width: int
    """Pixels of the panel."""
    height: int

    @classmethod
    def whole(cls, shape: tuple[int, ...], pixels: int) -> PlanarWindow:
        """The whole map, about so many pixels along its longer side."""
        nx, ny = shape
        scale = max(1, round(pixels / max(nx, ny)))
        return cls((nx, ny), scale, 0, 0, nx * scale, ny * scale)

    @property
    def is_whole(self) -> bool:
        """Whether it shows the whole map."""
        return self.width == self.shape[0] * self.scale and self.height == (
            self.shape[1] * self.scale
        )

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Lower corner x, y, width and height, in cells."""
        low_y = self.shape[1] - (self.top + self.height) / self.scale
        return self.left / self.scale, low_y, self.width / self.scale, self.height / self.scale

    @property
    def cells(self) -> tuple[slice, slice]:
        """The cells of which a part is shown."""
        x, y, width, height = self.extent
        return (
            slice(int(np.floor(x)), int(np.ceil(x + width))),
            slice(int(np.floor(y)), int(np.ceil(y + height))),
        )

    @property
    def resized(self) -> tuple[int, int]:
        """Pixels of these cells."""
        across, up = self.cells
        return (across.stop - across.start) * self.scale, (up.stop - up.start) * self.scale

    @property
    def cut(self) -> tuple[int, int]:
        """Columns and rows of pixels of these cells that are left and above of the panel."""
        across, up = self.cells
        return (
            self.left - across.start * self.scale,
            self.top - (self.shape[1] - up.stop) * self.scale,
        )

    def pixels(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn (k, 2) positions in cells to pixels of the panel, y down."""
        down = np.stack([positions[:, 0], self.shape[1] - positions[:, 1]], axis=1)
        return down * self.scale - (self.left, self.top)


def explored_window(
    sampled: NDArray[np.bool_],
    visited: NDArray[np.float64],
    margin: float,
    smallest: float,
    whole: PlanarWindow,
) -> PlanarWindow:
    """The smallest window of the size of a panel that has all that is sampled, with a margin.

    Parameters
    ----------
    sampled : (nx, ny) bool array
    visited : (k, 2) float array
        Positions that are shown too, in cells.
    margin : float
        Cells around.
    smallest : float
        Cells along the longer side, at least.
    whole : PlanarWindow
        The window of the whole map.
    """
    box = _bounding_box(sampled, visited)
    if box is None:
        return whole
    sides = np.array([whole.width, whole.height], dtype=np.float64)
    low = np.maximum(box[0] - margin, 0)
    high = np.minimum(box[1] + margin, whole.shape)
    # a window that moves in steps is up to half a step off the middle, but not at a border
    is_at_border = (low == 0) | (high == whole.shape)
    usable = np.where(is_at_border, 1, 1 - 1 / STEPS_PER_WINDOW)
    scale = whole.scale
    for larger in _zooms(whole.scale):
        cells = sides / larger
        if cells.max() < smallest or (high - low > usable * cells).any():
            break
        scale = larger
    cells = sides / scale
    step = cells / STEPS_PER_WINDOW
    start = np.rint(((low + high) / 2 - cells / 2) / step) * step
    start = np.clip(start, 0, whole.shape - cells)
    left, bottom = (int(value) for value in np.rint(start * scale))
    return PlanarWindow(
        whole.shape, scale, left, whole.shape[1] * scale - bottom - whole.height,
        whole.width, whole.height,
    )  # fmt: skip


def _bounding_box(
    sampled: NDArray[np.bool_], visited: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    """Lower and upper corner, in cells, or None around nothing."""
    corners = [visited[np.isfinite(visited).all(axis=1)]]
    if sampled.any():
        columns, rows = (np.flatnonzero(sampled.any(axis=axis)) for axis in (1, 0))
        corners.append(
            np.array([[columns[0], rows[0]], [columns[-1] + 1, rows[-1] + 1]], dtype=np.float64)
        )
    points = np.concatenate(corners)
    return (points.min(axis=0), points.max(axis=0)) if len(points) else None


def _zooms(scale: int) -> list[int]:
    """Pixels of a cell, larger and larger."""
    sizes = np.rint(scale * ZOOM_RATIO ** np.arange(1, 24)).astype(int)
    return [int(size) for size in np.unique(sizes) if size > scale]
