"""Which cells hide what is behind them, one bit a cell: sampled ones with P >= 1/2.

Few cells do, so that a view finds those within its reach in few words.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel, inlined_kernel, kernel
from coopmap_env.mapping.arrays import MapArrays

WORD = 64
"""Bits of a word: bit b of word w is flat cell `WORD` w + b."""


class ViewedMap(NamedTuple):
    """What views need of a map."""

    arrays: MapArrays
    occluders: NDArray[np.uint64]
    """Bits of the occluding cells, (n_cells / `WORD` rounded up,)."""


@inlined_kernel
def update_occluder(
    arrays: MapArrays, cell: int | np.integer[Any], occluders: NDArray[np.uint64]
) -> None:
    """Write the bit of a cell; most bits stay what they are."""
    index = np.uint64(cell)
    occludes = arrays.log_odds_fixed[index] >= 0 and arrays.sampled_mask[index] != 0
    word, bit = index // np.uint64(WORD), index % np.uint64(WORD)
    if (occluders[word] >> bit) & np.uint64(1) != np.uint64(occludes):
        occluders[word] ^= np.uint64(1) << bit


@kernel
def update_occluders(
    arrays: MapArrays, cells: NDArray[np.int32], occluders: NDArray[np.uint64]
) -> None:
    """Write the bits of some cells (flat indices)."""
    _update_occluders(arrays, cells, occluders)


@borrowing_kernel
def _update_occluders(
    arrays: MapArrays, cells: NDArray[np.int32], occluders: NDArray[np.uint64]
) -> None:
    for cell in cells:
        update_occluder(arrays, cell, occluders)


@kernel
def find_occluders(arrays: MapArrays) -> NDArray[np.uint64]:
    """Bits of all cells of a map."""
    n = len(arrays.sampled_mask)
    occluders = np.zeros((n + WORD - 1) // WORD, np.uint64)
    _find_occluders(arrays, occluders)
    return occluders


@borrowing_kernel
def _find_occluders(arrays: MapArrays, occluders: NDArray[np.uint64]) -> None:
    for cell in range(len(arrays.sampled_mask)):
        update_occluder(arrays, cell, occluders)
