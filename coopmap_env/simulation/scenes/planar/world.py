"""The true planar world that robots map, and the protocol of the scenes that make it.

A `PlanarWorld` is a grid of cells that are occupied or free. A `PlanarScene` makes worlds: always
the same one (a recorded map), or a new one for each state of the Generator that it is given.
"""

import math
from dataclasses import dataclass
from numbers import Real
from typing import Annotated, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief
from coopmap_env.core.settings import Bounds

MIN_CELLS_PER_SIDE = 8
"""Cells along a side: less than this leaves no room for a robot and something to map."""
CellsPerSide = Annotated[int, Bounds(at_least=MIN_CELLS_PER_SIDE)]
"""Type of the sides of a scene's shape."""
CellSide = Annotated[float, Bounds(above=0, smallest=1e-6, largest=1e12)]
"""Type of a scene's resolution, metres."""


@dataclass(frozen=True, eq=False)
class PlanarWorld:
    """One planar world: which cells are occupied, and where they lie in metres.

    The world ends at the border of the grid: there is nothing beyond, not even a wall.

    Attributes
    ----------
    occupied : (nx, ny) bool array
        True where a cell is occupied. The first axis is x, the second y. C-contiguous and
        read-only: a copy is kept, so the caller's array stays as it is.
    resolution : float
        Side of a cell in metres.
    origin : (float, float)
        Position in metres of the lower corner of cell (0, 0).
    name : str
        What this world is called in reports.

    Raises
    ------
    ValueError
        With the value, if a field is not as described, the grid is smaller than 8 x 8 cells
        or no cell is free.
    """

    occupied: NDArray[np.bool_]
    resolution: float
    origin: tuple[float, float]
    name: str

    def __post_init__(self) -> None:
        occupied = np.asarray(self.occupied)
        if occupied.ndim != 2:
            raise ValueError(f"occupied must have 2 axes (x, y), not shape {occupied.shape}")
        if occupied.dtype != np.bool_:
            raise ValueError(f"occupied must be a bool array, not {occupied.dtype}")
        if min(occupied.shape) < MIN_CELLS_PER_SIDE:
            raise ValueError(
                f"shape must be at least {MIN_CELLS_PER_SIDE} x {MIN_CELLS_PER_SIDE} cells, "
                f"not {occupied.shape}"
            )
        if occupied.all():
            raise ValueError(f"occupied has no free cell: all {occupied.size} are occupied")
        if not (_is_finite(self.resolution) and self.resolution > 0.0):
            raise ValueError(
                f"resolution must be finite and above 0 m, not {brief(self.resolution)}"
            )
        if np.shape(self.origin) != (2,) or not all(map(_is_finite, self.origin)):
            raise ValueError(f"origin must be two finite numbers (x, y), not {brief(self.origin)}")
        kept = np.array(occupied, order="C")
        kept.setflags(write=False)
        object.__setattr__(self, "occupied", kept)
        object.__setattr__(self, "resolution", float(self.resolution))
        object.__setattr__(self, "origin", (float(self.origin[0]), float(self.origin[1])))

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and y."""
        n_x, n_y = self.occupied.shape
        return n_x, n_y


def _is_finite(value: object) -> bool:
    """Whether a value is a finite number."""
    return isinstance(value, Real) and math.isfinite(value)


@runtime_checkable
class PlanarScene(Protocol):
    """Makes worlds of one shape, resolution and origin."""

    @property
    def name(self) -> str:
        """What the scene is called in reports."""

    @property
    def shape(self) -> tuple[int, int]:
        """Number of cells along x and y, the same for each world."""

    @property
    def resolution(self) -> float:
        """Side of a cell in metres."""

    @property
    def origin(self) -> tuple[float, float]:
        """Position in metres of the lower corner of cell (0, 0)."""

    def world(self, rng: np.random.Generator) -> PlanarWorld:
        """Make one world; every random choice comes from `rng`."""
