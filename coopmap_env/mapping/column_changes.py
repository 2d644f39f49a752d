"""When each vertical column of a map last changed.

Who makes something of the columns of a map, such as an observation, need make it again only where
they have changed since.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel


class ColumnChanges:
    """The changes of a map, counted, and the last one of each column.

    Parameters
    ----------
    shape : tuple of int
        Voxels of the map along x, y and z.
    """

    def __init__(self, shape: tuple[int, int, int]) -> None:
        nx, ny, self._nz = shape
        self.count = 0
        """Changes until now."""
        self.last_change = np.zeros(nx * ny, dtype=np.int64)
        """Number of the last change of each column (nx ny,), counted from 1; 0 if there is none."""

    def add(self, cells: NDArray[np.int32]) -> None:
        """Count a change of some cells (flat indices)."""
        self.count += 1
        mark_columns(cells, self._nz, self.count, self.last_change)

    def add_all(self) -> None:
        """Count a change of all cells."""
        self.count += 1
        self.last_change[:] = self.count


@kernel
def mark_columns(
    cells: NDArray[np.int32], nz: int, count: int, last_change: NDArray[np.int64]
) -> None:
    """Write the number of a change to the columns of some cells."""
    height = np.uint32(nz)
    for cell in cells:
        last_change[np.uint64(np.uint32(cell) // height)] = count  # 32 bits: half the time
