"""The kernels of `views` for calls from Python: plain tuples, and buffers of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.information.planar.cell_codes import reserve_cells, write_codes, write_view_codes
from coopmap_env.information.planar.view_arrays import (
    ViewTables,
    allocate_reserved,
    allocate_view,
)
from coopmap_env.information.planar.views import (
    evaluate_views,
    list_visible_cells,
    sequential_new_information,
)
from coopmap_env.mapping import MapArrays
from coopmap_env.sensing.beam_fan import FanArrays

CELLS_OF_MAP_PER_CELL_OF_VIEW = 6
"""So many cells of a whole map take the time of one cell of a view to code (measured)."""


@kernel
def code_cells(
    arrays: MapArrays,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan: FanArrays,
    tables: ViewTables,
) -> NDArray[np.uint8]:
    """Codes of the cells (n_cells,) that poses may see, others arbitrary; (0,) reserves none."""
    log_odds_fixed, sampled_mask = arrays.log_odds_fixed, arrays.sampled_mask
    codes = np.empty(len(sampled_mask), np.uint8)
    n = len(poses) * fan.max_visible_cells
    if n * CELLS_OF_MAP_PER_CELL_OF_VIEW < len(codes):
        nx, ny, _ = arrays.shape
        write_view_codes(
            log_odds_fixed, sampled_mask, (nx, ny), poses, fan, tables.of_log_odds, codes
        )
    else:
        write_codes(log_odds_fixed, sampled_mask, tables.of_log_odds, codes)
    if len(reserved_mask):
        reserve_cells(reserved_mask, tables.first_occupied, tables.uncounted, codes)
    return codes


@kernel
def evaluate_poses(
    map_tuple: PlainTuple,
    reserved_mask: NDArray[np.uint8],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """`evaluate_views` on a map."""
    arrays, fan, tables = MapArrays(*map_tuple), FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    codes, view = code_cells(arrays, reserved_mask, poses, fan, tables), allocate_view(fan, tables)
    nx, ny, _ = arrays.shape
    evaluate_views(codes, (nx, ny), poses, fan, tables, view, ni, unknown)


@kernel
def evaluate_coded_poses(
    codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """`evaluate_views` on the codes of a map."""
    fan, tables = FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    evaluate_views(codes, shape, poses, fan, tables, allocate_view(fan, tables), ni, unknown)


@kernel
def evaluate_team(
    map_tuple: PlainTuple,
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    ni: NDArray[np.float64],
) -> None:
    """`sequential_new_information` on a map."""
    arrays, fan, tables = MapArrays(*map_tuple), FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    codes = code_cells(arrays, np.empty(0, np.uint8), poses, fan, tables)
    view, reserved = allocate_view(fan, tables), allocate_reserved(fan, len(poses))
    nx, ny, _ = arrays.shape
    sequential_new_information(codes, (nx, ny), poses, fan, tables, view, reserved, ni)


@kernel
def find_visible_cells(
    map_tuple: PlainTuple,
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    cells: NDArray[np.int64],
) -> int:
    """`list_visible_cells` of one pose (1,) on a map; return how many there are."""
    arrays, fan, tables = MapArrays(*map_tuple), FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    codes = code_cells(arrays, np.empty(0, np.uint8), poses, fan, tables)
    view, (nx, ny, _) = allocate_view(fan, tables), arrays.shape
    evaluate_views(codes, (nx, ny), poses, fan, tables, view, np.empty(1), np.empty(1, np.int64))
    return list_visible_cells((nx, ny), poses[0], fan, view, cells)
