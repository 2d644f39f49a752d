"""Kernels of planar scans: the true distance along each beam, and the noise of its measurement.

`simulate_scan` casts rays from any pose. `scan_from_lattice` does the same for a camera at the
center of a cell that faces one of the headings of a `BeamFan`: one pass over the fan's cells, where
near the camera many beams share a cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import power, sin_cos
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.core.random_streams import normal_pair, random_block, take_blocks
from coopmap_env.core.words import lowest_bit
from coopmap_env.geometry import start_ray, step_ray
from coopmap_env.sensing import NoiseParameters, ScanArrays
from coopmap_env.sensing.beam_fan import BEAMS_PER_WORD, FanArrays


class PlanarCameraArrays(NamedTuple):
    """A planar camera and its range noise, as kernels take them."""

    beams: NDArray[np.float64]
    """Unit directions in the camera frame (n_beams, 2)."""
    reach: float
    """Depth of field, metres."""
    noise: NoiseParameters
    """Eq. 1."""


@inlined_kernel
def _entry_along_axis(position: float, cell: int, direction: float) -> float:
    """Distance at which a ray passes the near face of a cell along one axis, cells."""
    if direction > 0.0:
        return (cell - position) / direction
    if direction < 0.0:
        return (cell + 1.0 - position) / direction
    return 0.0


@inlined_kernel
def _entry_distance(px: float, py: float, ix: int, iy: int, ux: float, uy: float) -> float:
    """Distance at which a ray that crosses cell (ix, iy) enters it, cells."""
    x, y = _entry_along_axis(px, ix, ux), _entry_along_axis(py, iy, uy)
    return max(x, y, 0.0)


@kernel
def cast_ray(
    occupied: NDArray[np.bool_], px: float, py: float, ux: float, uy: float, reach: float
) -> float:
    """Distance (cells) at which a ray enters the first occupied cell; inf if there is none."""
    nx, ny = occupied.shape
    ray, position = start_ray((px, py, 0.5), (ux, uy, 0.0), (nx, ny, 1))
    end = min(reach, ray.end)
    flat = occupied.ravel()
    while position.distance < end:
        if flat[position.cell]:
            return _entry_distance(px, py, position.cell // ny, position.cell % ny, ux, uy)
        position = step_ray(ray, position)
    return math.inf


@inlined_kernel
def _write_free_beam(
    beam: int, pose: NDArray[np.float64], ux: float, uy: float, reach: float, scan: ScanArrays
) -> None:
    """Write a beam without a hit: it is free up to its reach, metres."""
    _, points, covariances, hit = scan
    hit[beam] = False
    points[beam, 0] = pose[0] + reach * ux
    points[beam, 1] = pose[1] + reach * uy
    covariances[beam, 0, 0] = 0.0
    covariances[beam, 0, 1] = 0.0
    covariances[beam, 1, 0] = 0.0
    covariances[beam, 1, 1] = 0.0


@borrowing_kernel
def _measure_hit(
    beam: int,
    pose: NDArray[np.float64],
    axes: tuple[float, float, float, float],
    d: float,
    noise: NoiseParameters,
    stream: NDArray[np.uint64],
    scan: ScanArrays,
) -> None:
    """Write the measurement of a surface at d metres: Eq. 1, rotated into the world by Eq. 3.

    `axes` are sine and cosine of the camera's heading, and the beam's unit direction in the world.
    """
    s, c, ux, uy = axes
    _, points, covariances, hit = scan
    hit[beam] = True
    scale = noise.intrinsic * power(d, noise.exponent)
    word, other, _, _ = random_block(stream, beam)
    along, across = normal_pair(word, other)
    ex, ey = scale * noise.depth * along, scale * noise.lateral * across
    points[beam, 0] = pose[0] + d * ux + c * ex - s * ey
    points[beam, 1] = pose[1] + d * uy + s * ex + c * ey
    # the camera states Eq. 1 at the distance that it measured, not at the true one
    mx, my = points[beam, 0] - pose[0], points[beam, 1] - pose[1]
    scale = noise.intrinsic * power(math.sqrt(mx * mx + my * my), noise.exponent)
    xx, yy = (scale * noise.depth) ** 2, (scale * noise.lateral) ** 2
    covariances[beam, 0, 0] = c * c * xx + s * s * yy
    covariances[beam, 0, 1] = c * s * (xx - yy)
    covariances[beam, 1, 0] = covariances[beam, 0, 1]
    covariances[beam, 1, 1] = s * s * xx + c * c * yy


@kernel
def simulate_scan(
    occupied: NDArray[np.bool_],
    grid: PlainTuple,
    pose: NDArray[np.float64],
    camera: PlainTuple,
    stream: NDArray[np.uint64],
    scan: PlainTuple,
) -> None:
    """Fill a scan from any pose (3,) inside the grid: cast each beam, add noise to the hits.

    Beam b has the numbers of block b of the stream, which goes on by a block for each beam. `grid`,
    `camera` and `scan` are a plain `GridGeometry`, `PlanarCameraArrays` and `ScanArrays`.
    """
    lower, resolution, _ = grid
    beams, reach, noise_tuple = camera
    noise, arrays = NoiseParameters(*noise_tuple), ScanArrays(*scan)
    px, py = (pose[0] - lower[0]) / resolution, (pose[1] - lower[1]) / resolution
    s, c = sin_cos(pose[2])
    for beam in range(len(beams)):
        ux = c * beams[beam, 0] - s * beams[beam, 1]
        uy = s * beams[beam, 0] + c * beams[beam, 1]
        d = cast_ray(occupied, px, py, ux, uy, reach / resolution) * resolution
        if d < math.inf:
            _measure_hit(beam, pose, (s, c, ux, uy), d, noise, stream, arrays)
        else:
            _write_free_beam(beam, pose, ux, uy, reach, arrays)
    take_blocks(stream, len(beams))


@borrowing_kernel
def scan_from_lattice(
    occupied: NDArray[np.bool_],
    shape: tuple[int, int],
    resolution: float,
    cell: int,
    heading: int,
    pose: NDArray[np.float64],
    fan: FanArrays,
    camera: PlanarCameraArrays,
    stream: NDArray[np.uint64],
    scan: ScanArrays,
    free_beams: NDArray[np.uint64],
) -> None:
    """`simulate_scan` from the center of a flat cell; `occupied` (n_cells,) is flat.

    `pose` (3,) is that of the cell and the heading, metres and radians. `free_beams` (words,)
    becomes the bits of the beams without a hit.
    """
    (nx, ny), (beams, reach, noise) = shape, camera
    ix, iy = cell // ny, cell % ny
    s, c = sin_cos(pose[2])
    is_inside = fan.max_offset <= ix < nx - fan.max_offset
    is_inside &= fan.max_offset <= iy < ny - fan.max_offset
    for word in range(len(free_beams)):
        free_beams[word] = fan.all_beams[word]
    for entry in range(fan.start[heading], fan.start[heading + 1]):
        k = np.uint64(entry)
        if not is_inside:
            i, j = ix + fan.offsets[k, 0], iy + fan.offsets[k, 1]
            if i < 0 or i >= nx or j < 0 or j >= ny:
                continue
        if not occupied[np.uint64(cell + fan.flat_offsets[k])]:
            continue
        i, j = ix + fan.offsets[k, 0], iy + fan.offsets[k, 1]
        for word in range(len(free_beams)):
            ended = free_beams[word] & fan.beams[word, k]
            free_beams[word] &= ~ended
            while ended:
                bit = lowest_bit(ended)
                ended &= ended - np.uint64(1)
                beam = word * BEAMS_PER_WORD + bit
                ux = c * beams[beam, 0] - s * beams[beam, 1]
                uy = s * beams[beam, 0] + c * beams[beam, 1]
                d = _entry_distance(ix + 0.5, iy + 0.5, i, j, ux, uy) * resolution
                _measure_hit(beam, pose, (s, c, ux, uy), d, noise, stream, scan)
    for word in range(len(free_beams)):
        left = free_beams[word]
        while left:
            bit = lowest_bit(left)
            left &= left - np.uint64(1)
            beam = word * BEAMS_PER_WORD + bit
            ux = c * beams[beam, 0] - s * beams[beam, 1]
            uy = s * beams[beam, 0] + c * beams[beam, 1]
            _write_free_beam(beam, pose, ux, uy, reach, scan)
    take_blocks(stream, len(beams))
