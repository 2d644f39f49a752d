"""Kernels that write what planar robots observe: map crop, own pose, teammates, candidates."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos, sin_cos_array
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, inlined_kernel, kernel
from coopmap_env.geometry import wrap_scalar_angle
from coopmap_env.mapping import LogOddsRange, MapArrays, VoxelGrid
from coopmap_env.robots import LatticeGeometry, pose_from_id

N_CHANNELS = 4
N_FEATURES = 9


class CropTables(NamedTuple):
    """How the map is drawn around a camera."""

    side: int
    """Cells."""
    offsets: NDArray[np.int32]
    """Cell offsets (n_headings, side * side, 2); see `crop_offsets`."""
    flat_offsets: NDArray[np.int32]
    """The same as differences of flat indices (n_headings, side * side)."""
    margin: int
    """The largest offset along an axis."""
    byte_of_log_odds: NDArray[np.uint8]
    """255 P, rounded, of each log-odds value in fixed point (2 clamp + 1,)."""

    @classmethod
    def make(cls, side: int, n_headings: int, ny: int, log_odds_range: LogOddsRange) -> CropTables:
        """Tables of a crop of `side` cells, on a grid with ny cells along y."""
        offsets = crop_offsets(side, n_headings)
        return cls(
            side,
            offsets,
            offsets[..., 0] * np.int32(ny) + offsets[..., 1],
            int(np.abs(offsets).max()),
            np.round(255 * log_odds_range.probability).astype(np.uint8),
        )


class WorldExtent(NamedTuple):
    """Extent of the world, metres."""

    origin: tuple[float, ...]
    """Lower corner."""
    size: tuple[float, ...]
    """Along x and y."""
    resolution: float
    """Edge of a cell."""

    @classmethod
    def of_grid(cls, grid: VoxelGrid) -> WorldExtent:
        """That of a grid."""
        size = tuple(n * grid.resolution for n in grid.shape)
        return cls(grid.origin, size, float(grid.resolution))


class ObservationArrays(NamedTuple):
    """The entries ``map``, ``pose`` and ``teammates`` of all robots' observations."""

    maps: NDArray[np.uint8]
    """Shape (n, 4, side, side)."""
    pose_vectors: NDArray[np.float32]
    """Shape (n, 4)."""
    teammates: NDArray[np.float32]
    """Shape (n, n - 1, 4)."""


class TeamObservations(NamedTuple):
    """Observations of E worlds with N robots each."""

    views: ObservationArrays
    """Shapes (E, N, ...)."""
    features: NDArray[np.float32]
    """Shape (E, N, m, 9)."""
    action_mask: NDArray[np.int8]
    """Shape (E, N, m)."""

    @classmethod
    def empty(cls, n_worlds: int, n_robots: int, side: int, m: int) -> TeamObservations:
        """Room for the observations of crops of `side` cells and m candidates."""
        team = (n_worlds, n_robots)
        views = ObservationArrays(
            np.empty((*team, N_CHANNELS, side, side), dtype=np.uint8),
            np.empty((*team, 4), dtype=np.float32),
            np.empty((*team, n_robots - 1, 4), dtype=np.float32),
        )
        return cls(
            views,
            np.empty((*team, m, N_FEATURES), dtype=np.float32),
            np.empty((*team, m), dtype=np.int8),
        )


@inlined_kernel
def name_observations(t: PlainTuple) -> TeamObservations:
    """Name the parts of a plain `TeamObservations`."""
    return TeamObservations(ObservationArrays(*t[0]), t[1], t[2])


class RatedCandidates(NamedTuple):
    """The arrays of `Ratings` and the unknown cells in view of k candidates; each of shape (k,)."""

    new_information: NDArray[np.float64]
    motion_cost: NDArray[np.float64]
    occupancy: NDArray[np.float64]
    rating: NDArray[np.float64]
    unknown_cells: NDArray[np.int64]


class FeatureScale(NamedTuple):
    """Normalization of candidate features."""

    diagonal: float
    """Diagonal of the world, metres."""
    max_information: float
    """The largest NI, nats."""
    max_visible_cells: int
    limit: float
    """Largest absolute value of a feature."""


def crop_offsets(side: int, n_headings: int) -> NDArray[np.int32]:
    """Cell offsets (n_headings, side * side, 2) of a crop's cells from the camera's cell."""
    steps = np.arange(side) + 0.5 - side / 2
    ahead, left = np.meshgrid(steps, steps, indexing="ij")
    angles = np.arange(n_headings)[:, None] * (2 * math.pi / n_headings)
    s, c = sin_cos_array(angles)
    x = c * ahead.ravel() - s * left.ravel()
    y = s * ahead.ravel() + c * left.ravel()
    # 1e-9: a point on the border between two cells goes to the same side for every heading
    return np.floor(np.stack([x, y], axis=-1) + 0.5 + 1e-9).astype(np.int32)


@borrowing_kernel
def write_map_crop(
    arrays: MapArrays, cell: int, heading: int, tables: CropTables, out: NDArray[np.uint8]
) -> None:
    """Fill channels 0, 1 and 3 and clear 2; `out` is (4, side * side).

    In a row of the crop, the cells inside the world follow each other. Where the camera is closer
    to the world's border than the margin, they are searched from both ends of the row.
    """
    nx, ny, _ = arrays.shape
    cx, cy, margin = cell // ny, cell % ny, tables.margin
    flat, inside = tables.flat_offsets[heading], out[3]
    out[2] = 0
    if margin <= cx < nx - margin and margin <= cy < ny - margin:
        inside[:] = 255
        _write_cells(arrays, cell, flat, 0, len(flat), tables.byte_of_log_odds, out)
        return
    out[0] = tables.byte_of_log_odds[arrays.clamp]
    out[1] = 0
    inside[:] = 0
    x, y = np.int32(cx), np.int32(cy)
    offsets, end_x, end_y = tables.offsets[heading], np.uint32(nx), np.uint32(ny)
    for start in range(0, len(flat), tables.side):
        first, end = start, start + tables.side
        while first < end and not _is_inside(x, y, offsets[first], end_x, end_y):
            first += 1
        while first < end and not _is_inside(x, y, offsets[end - 1], end_x, end_y):
            end -= 1
        _write_cells(arrays, cell, flat, first, end, tables.byte_of_log_odds, out)
        inside[first:end] = 255


@inlined_kernel
def _is_inside(
    x: np.int32, y: np.int32, offset: NDArray[np.int32], end_x: np.uint32, end_y: np.uint32
) -> np.bool_:
    """Whether a cell lies in the world; as unsigned numbers, negative indices are huge."""
    return np.uint32(x + offset[0]) < end_x and np.uint32(y + offset[1]) < end_y


@inlined_kernel
def _write_cells(
    arrays: MapArrays,
    cell: int,
    flat: NDArray[np.int32],
    first: int,
    end: int,
    byte_of_log_odds: NDArray[np.uint8],
    out: NDArray[np.uint8],
) -> None:
    """Fill channels 0 and 1 of some cells of a crop, which lie in the world."""
    log_odds_fixed, sampled, clamp = arrays.log_odds_fixed, arrays.sampled_mask, arrays.clamp
    occupancy, known = out[0], out[1]
    for k in range(np.uint64(first), np.uint64(end)):
        at = np.uint64(cell + flat[k])
        occupancy[k] = byte_of_log_odds[np.uint64(log_odds_fixed[at] + clamp)]
        known[k] = np.uint8(255) * sampled[at]


@borrowing_kernel
def write_teammates(
    poses: NDArray[np.float64],
    robot: int,
    resolution: float,
    diagonal: float,
    out: NDArray[np.uint8],
    teammates: NDArray[np.float32],
) -> None:
    """Fill channel 2 of a robot's map (4, side, side) and its rows (n - 1, 4) of teammates."""
    side = out.shape[1]
    middle = side / 2.0 + 1e-9  # a teammate on the border of two cells: as in `crop_offsets`
    s, c = sin_cos(poses[robot, 2])
    row = 0
    for teammate in range(len(poses)):
        if teammate == robot:
            continue
        dx, dy = poses[teammate, 0] - poses[robot, 0], poses[teammate, 1] - poses[robot, 1]
        ahead, left, turn = c * dx + s * dy, c * dy - s * dx, poses[teammate, 2] - poses[robot, 2]
        teammates[row, 0] = ahead / diagonal
        teammates[row, 1] = left / diagonal
        teammates[row, 3], teammates[row, 2] = sin_cos(turn)
        row += 1
        i = math.floor(ahead / resolution + middle)
        j = math.floor(left / resolution + middle)
        for u in range(max(i - 1, 0), min(i + 2, side)):
            for v in range(max(j - 1, 0), min(j + 2, side)):
                out[2, u, v] = 255


@kernel
def write_pose_vector(
    pose: NDArray[np.float64], world_tuple: PlainTuple, out: NDArray[np.float32]
) -> None:
    """Fill the entry ``pose`` (4,) of a pose (3,); `world_tuple` is a plain `WorldExtent`."""
    world = WorldExtent(*world_tuple)
    out[0] = (pose[0] - world.origin[0]) / world.size[0]
    out[1] = (pose[1] - world.origin[1]) / world.size[1]
    out[3], out[2] = sin_cos(pose[2])


@borrowing_kernel
def write_observations(
    map_tuple: PlainTuple,
    world_tuple: PlainTuple,
    crop_tuple: PlainTuple,
    pose_ids: NDArray[np.int64],
    poses: NDArray[np.float64],
    maps: NDArray[np.uint8],
    pose_vectors: NDArray[np.float32],
    teammates: NDArray[np.float32],
) -> None:
    """Fill the maps, own pose vectors and teammates of all robots, as of `ObservationArrays`.

    `pose_ids` (n,) are those of the lattice, `poses` (n, 3) the same in metres and radians. The
    tuples are plain `MapArrays`, `WorldExtent` and `CropTables`.
    """
    arrays, world = MapArrays(*map_tuple), WorldExtent(*world_tuple)
    tables = CropTables(*crop_tuple)
    size = world.size
    n_headings = len(tables.offsets)
    diagonal = math.sqrt(size[0] * size[0] + size[1] * size[1])
    for robot in range(len(pose_ids)):
        cell, heading = pose_ids[robot] // n_headings, pose_ids[robot] % n_headings
        image = maps[robot]
        flat = image.reshape(image.shape[0], -1)
        write_map_crop(arrays, cell, heading, tables, flat)
        write_teammates(poses, robot, world.resolution, diagonal, image, teammates[robot])
        write_pose_vector(poses[robot], world, pose_vectors[robot])


@borrowing_kernel
def write_candidate_features(
    ids: NDArray[np.int64],
    counts: NDArray[np.int64],
    cameras: NDArray[np.float64],
    lattice_tuple: PlainTuple,
    rated_tuple: PlainTuple,
    scale_tuple: PlainTuple,
    features: NDArray[np.float32],
    mask: NDArray[np.int8],
) -> None:
    """Fill the features and masks of all robots' candidates.

    `ids` (k,) are the pose ids of the first robot's candidates, then those of the next; `counts`
    (n,) the number of each robot, `cameras` (n, 3) its pose. The tuples are plain
    `LatticeGeometry`, `RatedCandidates` and `FeatureScale`.
    """
    lattice, rated = LatticeGeometry(*lattice_tuple), RatedCandidates(*rated_tuple)
    scale = FeatureScale(*scale_tuple)
    k = 0
    for robot in range(len(counts)):
        x, y, heading = cameras[robot]
        s, c = sin_cos(heading)
        for row in range(counts[robot]):
            to_x, to_y, to_heading = pose_from_id(ids[k], lattice)
            dx, dy, turn = to_x - x, to_y - y, wrap_scalar_angle(to_heading - heading)
            out = features[robot, row]
            out[0] = (c * dx + s * dy) / scale.diagonal
            out[1] = (c * dy - s * dx) / scale.diagonal
            out[3], out[2] = sin_cos(turn)
            out[4] = rated.new_information[k] / scale.max_information
            out[5] = min(rated.motion_cost[k] / scale.max_information, scale.limit)
            out[6] = rated.occupancy[k]
            out[7] = max(rated.rating[k] / scale.max_information, -scale.limit)
            out[8] = rated.unknown_cells[k] / scale.max_visible_cells
            mask[robot, row] = 1
            k += 1
