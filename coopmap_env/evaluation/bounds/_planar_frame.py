"""A planar world with a frame so wide that views from inside end in it: no border to test for."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from coopmap_env.sensing.beam_fan import FanArrays

Number = TypeVar("Number", bound=np.generic)


@dataclass(frozen=True)
class PlanarFrame:
    """How flat indices in the world and in the framed world belong together."""

    shape: tuple[int, int]
    """Cells of the world along x and y."""
    margin: int
    """Cells of the frame on each side."""

    @property
    def width(self) -> int:
        """Cells of the framed world along y."""
        return self.shape[1] + 2 * self.margin

    def around(self, values: NDArray[Number], fill: float) -> NDArray[Number]:
        """Values (..., n_cells) with others in the frame, (..., n_framed)."""
        rows = values.reshape(*values.shape[:-1], *self.shape)
        sides = [(0, 0)] * (rows.ndim - 2) + [(self.margin, self.margin)] * 2
        framed: NDArray[Number] = np.pad(rows, sides, constant_values=fill)
        return framed.reshape(*values.shape[:-1], -1)

    def framed(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices of cells of the world in the framed world."""
        x, y = np.divmod(cells, self.shape[1])
        return (x + self.margin) * self.width + y + self.margin

    def unframed(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        """Indices of cells of the framed world in the world."""
        x, y = np.divmod(cells, self.width)
        return (x - self.margin) * self.shape[1] + y - self.margin

    def fan(self, fan: FanArrays) -> FanArrays:
        """The fan in the framed world."""
        offsets = fan.offsets.astype(np.int64)
        flat = offsets[:, 0] * self.width + offsets[:, 1]
        return fan._replace(flat_offsets=flat.astype(np.int32))
