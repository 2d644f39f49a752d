"""The kernels of `views` for calls from Python: plain tuples, and buffers of their own."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.information.planar.fan import FanArrays
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


@kernel
def evaluate_poses(
    codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    ni: NDArray[np.float64],
    unknown: NDArray[np.int64],
) -> None:
    """`evaluate_views`."""
    fan, tables = FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    view = allocate_view(fan, tables.n_bins)
    evaluate_views(codes, shape, poses, fan, tables, view, ni, unknown)


@kernel
def evaluate_team(
    codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    ni: NDArray[np.float64],
) -> None:
    """`sequential_new_information`."""
    fan, tables = FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    view, reserved = allocate_view(fan, tables.n_bins), allocate_reserved(fan, len(poses))
    sequential_new_information(codes, shape, poses, fan, tables, view, reserved, ni)


@kernel
def find_visible_cells(
    codes: NDArray[np.uint8],
    shape: tuple[int, ...],
    poses: NDArray[np.int64],
    fan_tuple: PlainTuple,
    tables_tuple: PlainTuple,
    cells: NDArray[np.int64],
) -> int:
    """`list_visible_cells` of one pose (1,); return how many there are."""
    fan, tables = FanArrays(*fan_tuple), ViewTables(*tables_tuple)
    view = allocate_view(fan, tables.n_bins)
    evaluate_views(codes, shape, poses, fan, tables, view, np.empty(1), np.empty(1, np.int64))
    return list_visible_cells(shape, poses[0], fan, view, cells)
