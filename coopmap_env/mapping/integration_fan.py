"""`integrate_rays` for a planar scan from a camera's lattice: equal, and faster.

Beams without a hit cross the cells that the camera's `BeamFan` lists. Where k of them cross a cell,
it gets k times the update of a free beam, in one pass over the fan. Beams that hit are measured
with noise, so that each goes its own way; they are followed one by one.

A beam exactly along a diagonal runs through corners of cells. There, one that is followed to its
rounded end may touch another cell than the fan lists.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import borrowing_kernel
from coopmap_env.core.words import count_bits
from coopmap_env.mapping.arrays import UpdateBuffers
from coopmap_env.mapping.beam import BeamParameters
from coopmap_env.mapping.grid import GridGeometry
from coopmap_env.mapping.integration_scalar import (
    BeamBuffers,
    add_nonzero,
    integrate_beam,
    set_camera,
)
from coopmap_env.sensing import ScanArrays
from coopmap_env.sensing.beam_fan import FanArrays


@borrowing_kernel
def _update_cells_of_free_beams(
    cell: int,
    heading: int,
    fan: FanArrays,
    free_beams: NDArray[np.uint64],
    grid: GridGeometry,
    lowest: int,
    buffers: UpdateBuffers,
) -> int:
    """Update what the beams without a hit cross; return how many cells that are."""
    pending, updated_cells, _ = buffers
    nx, ny, _ = grid.shape
    ix, iy = cell // ny, cell % ny
    is_inside = fan.max_offset <= ix < nx - fan.max_offset
    is_inside &= fan.max_offset <= iy < ny - fan.max_offset
    count = 0
    for entry in range(fan.start[heading], fan.start[heading + 1]):
        k = np.uint64(entry)
        n_free = 0
        for word in range(len(free_beams)):
            n_free += count_bits(fan.beams[word, k] & free_beams[word])
        if n_free == 0:
            continue
        if not is_inside:
            i, j = ix + fan.offsets[k, 0], iy + fan.offsets[k, 1]
            if i < 0 or i >= nx or j < 0 or j >= ny:
                continue
        crossed = np.uint64(cell + fan.flat_offsets[k])
        updated_cells[np.uint64(count)] = crossed
        count += 1
        pending[crossed] = add_nonzero(0, n_free * lowest)
    return count


@borrowing_kernel
def integrate_lattice_scan(
    scan: ScanArrays,
    cell: int,
    heading: int,
    fan: FanArrays,
    free_beams: NDArray[np.uint64],
    grid: GridGeometry,
    beam: BeamParameters,
    scratch: BeamBuffers,
    buffers: UpdateBuffers,
    hit_cells: NDArray[np.int64],
) -> int:
    """Follow every beam of a scan from the center of a flat cell, along a heading of the fan.

    `free_beams` (words,) has the bits of the beams without a hit. Surfaces must not be partial.
    Otherwise as `integrate_rays`.
    """
    count = _update_cells_of_free_beams(cell, heading, fan, free_beams, grid, beam.lowest, buffers)
    set_camera(scan.origin, grid, scratch)
    for k in range(len(scan.points)):
        hit_cells[k] = -1
        if scan.hit[k]:
            count, hit_cells[k] = integrate_beam(k, scan, grid, beam, scratch, buffers, count)
    return count
