"""VoxelGrid: conversion between metric points and cell indices."""

from __future__ import annotations

import math
import operator
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.kernels import inlined_kernel
from coopmap_env.core.limits import check_cells

Number = TypeVar("Number", int, float)


class GridGeometry(NamedTuple):
    """A `VoxelGrid` as kernels take it."""

    lower: NDArray[np.float64]
    """Lower corner (D,), metres."""
    resolution: float
    """Edge of a cell, metres."""
    shape: tuple[int, int, int]
    """Cells along x, y, z; a planar grid is one layer."""


@inlined_kernel
def write_center(grid: GridGeometry, cell: int, center: NDArray[np.float64]) -> None:
    """Write the center (D,) of a flat cell, metres."""
    lower, resolution, (_, ny, nz) = grid
    center[0] = (cell // (ny * nz) + 0.5) * resolution + lower[0]
    center[1] = (cell // nz % ny + 0.5) * resolution + lower[1]
    if len(center) == 3:
        center[2] = (cell % nz + 0.5) * resolution + lower[2]


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
        If a value is outside of its range, or the grid has more cells than the limit of
        `coopmap_env.core.limits`.
    """

    shape: tuple[int, ...]
    resolution: float = 1.0
    origin: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        shape = _convert(operator.index, self.shape) or ()
        if len(shape) not in (2, 3) or min(shape) < 1:
            raise ValueError(
                f"VoxelGrid.shape needs 2 or 3 positive integers, got {brief(self.shape)}"
            )
        check_cells(shape, f"VoxelGrid.shape {brief(shape)}")
        (resolution,) = _convert(float, [self.resolution]) or (math.nan,)
        if not 0 < resolution < math.inf:
            raise ValueError(
                f"VoxelGrid.resolution must be finite and > 0, got {brief(self.resolution)}"
            )
        origin = _convert(float, self.origin)
        if origin == ():
            origin = (0.0,) * len(shape)
        if origin is None or len(origin) != len(shape) or not all(map(math.isfinite, origin)):
            raise ValueError(
                f"VoxelGrid.origin must be {len(shape)} finite values, got {brief(self.origin)}"
            )
        object.__setattr__(self, "shape", shape)
        object.__setattr__(self, "resolution", resolution)
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


def _convert(kind: Callable[[Any], Number], values: Iterable[Any]) -> tuple[Number, ...] | None:
    """Values as numbers of a kind; None if one of them is no such number."""
    try:
        return tuple(kind(value) for value in values)
    except (TypeError, ValueError, OverflowError):
        return None
