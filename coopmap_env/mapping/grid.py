"""VoxelGrid: conversion between metric points and cell indices."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray


class GridGeometry(NamedTuple):
    """A `VoxelGrid` as kernels take it."""

    lower: NDArray[np.float64]
    """Lower corner (D,), metres."""
    resolution: float
    """Edge of a cell, metres."""
    shape: tuple[int, int, int]
    """Cells along x, y, z; a planar grid is one layer."""


@dataclass(frozen=True)
class VoxelGrid:
    """A regular grid of square (2-D) or cubic (3-D) cells in the world frame.

    Parameters
    ----------
    shape : tuple of D ints, D = 2 or 3
        Cells along x, y (and z).
    resolution : float
        Edge of a cell, metres.
    origin : tuple of D floats
        Lower corner of cell (0, 0[, 0]), metres.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    shape: tuple[int, ...]
    resolution: float = 1.0
    origin: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        shape = tuple(int(n) for n in self.shape)
        if len(shape) not in (2, 3) or min(shape) < 1:
            raise ValueError(f"VoxelGrid.shape needs 2 or 3 positive sizes, got {self.shape}")
        if not (math.isfinite(self.resolution) and self.resolution > 0):
            raise ValueError(f"VoxelGrid.resolution must be finite and > 0, got {self.resolution}")
        origin = tuple(float(o) for o in self.origin) or (0.0,) * len(shape)
        if len(origin) != len(shape) or not all(map(math.isfinite, origin)):
            raise ValueError(f"VoxelGrid.origin must be {len(shape)} finite values, got {origin}")
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "origin", origin)

    @property
    def dimension(self) -> int:
        """D, 2 or 3."""
        return len(self.shape)

    @property
    def n_cells(self) -> int:
        """Number of cells."""
        return math.prod(self.shape)

    @property
    def shape_3d(self) -> tuple[int, int, int]:
        """Cells along x, y, z; a planar grid is one layer."""
        nx, ny, nz = (*self.shape, 1)[:3]
        return nx, ny, nz

    @cached_property
    def geometry(self) -> GridGeometry:
        """Corner, resolution and shape, for kernels."""
        return GridGeometry(np.array(self.origin), float(self.resolution), self.shape_3d)

    def to_cell_units(self, points: ArrayLike) -> NDArray[np.float64]:
        """Positions (..., D) of points in cells from the grid's lower corner, not rounded."""
        return (np.asarray(points, dtype=np.float64) - self.origin) / self.resolution

    def index(self, points: ArrayLike) -> NDArray[np.int64]:
        """Index (..., D) of the cell that holds each point; may lie outside the grid."""
        return np.floor(self.to_cell_units(points)).astype(np.int64)

    def center(self, index: ArrayLike) -> NDArray[np.float64]:
        """Centers (..., D) of cells, metres."""
        return (np.asarray(index) + 0.5) * self.resolution + self.origin

    def contains(self, index: ArrayLike) -> NDArray[np.bool_]:
        """Whether each index (..., D) lies inside the grid."""
        index = np.asarray(index)
        inside: NDArray[np.bool_] = np.logical_and(index >= 0, index < self.shape)
        return np.asarray(inside.all(axis=-1))

    def flat_index(self, index: ArrayLike) -> NDArray[np.int64]:
        """Flat (row-major) cell numbers of indices (..., D) inside the grid."""
        return np.ravel_multi_index(tuple(np.moveaxis(np.asarray(index), -1, 0)), self.shape)
