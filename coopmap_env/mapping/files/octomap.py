"""OctoMap's files, through OctoMap's own library (extra ``octomap``).

``.ot`` holds the log-odds of every voxel as a 32-bit float. Log-odds in steps of 1/1024 nat are
such floats exactly. A sampled cell with log-odds 0 is a node with 0, a never sampled cell has no
node, so a round trip loses nothing of the occupancy. Surface estimates are not stored: see `npz`
and `ply`. ``.bt`` holds one bit per voxel, occupied from P = 1/2 on; read back, such cells are at
the clamp.

OctoMap's voxels lie at integer multiples of their edge. A grid whose origin does not is written
with a shift of at most half a cell (`octomap_shift`). A comment in the file's header holds the grid
and the map's constants; OctoMap's readers skip it. Files of other programs have no such comment:
the grid is then the bounding box of the known voxels, and log-odds are rounded to fixed point and
clamped.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import atomic_path, read_bytes
from coopmap_env.mapping.files.base import (
    MapFileError,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import STEPS_PER_NAT
from coopmap_env.mapping.occupancy_map import OccupancyMap

CENTER_KEY = 1 << 15
"""Key of the voxel whose lower corner is OctoMap's origin; keys are 16 bits."""
COMMENT_PREFIX = b"# coopmap "
NODE_BYTES = 5
"""Size of a node in an ``.ot`` file: a float and which children it has."""
MAX_CELLS = 100_000_000
"""Cells: a file of another program whose bounding box is larger is rejected, as maps are dense."""


def save_octomap(map_: OccupancyMap, path: str | os.PathLike[str]) -> None:
    """Write a 3-D map as ``.ot`` (exact) or ``.bt`` (one bit per voxel), by the suffix.

    Raises
    ------
    ValueError
        If the map is planar or does not fit between OctoMap's keys.
    """
    path = Path(path)
    with atomic_path(path) as temporary:
        tree = to_octree(map_)
        write = tree.writeBinary if path.suffix.lower() == ".bt" else tree.write
        if not write(str(temporary)):
            raise OSError(f"OctoMap could not write {path}")
        # after the line of the header that allows comments
        first, second, rest = temporary.read_bytes().split(b"\n", 2)
        comment = COMMENT_PREFIX + settings_to_json(map_).encode()
        temporary.write_bytes(b"\n".join((first, second, comment, rest)))


def to_octree(map_: OccupancyMap) -> Any:
    """The map as a `pyoctomap.OcTree`: one node of depth 16 for each sampled cell.

    Its coordinates are those of the map minus `octomap_shift`.
    """
    octomap = import_optional("pyoctomap", "octomap")
    base = _first_key(map_.grid)
    tree = octomap.OcTree(map_.grid.resolution)
    # nodes are clamped when they are made: wider than the clamp of any map
    tree.setClampingThresMin(1e-12)
    tree.setClampingThresMax(1 - 1e-12)
    flat = np.flatnonzero(map_.sampled_mask)
    keys = np.stack(np.unravel_index(flat, map_.grid.shape), axis=-1) + base
    values = map_.log_odds_fixed[flat] / STEPS_PER_NAT
    for key, value in zip(keys.tolist(), values.tolist(), strict=True):
        tree.updateNode(octomap.OcTreeKey(*key), value, True)
    tree.updateInnerOccupancy()
    return tree


def octomap_shift(grid: VoxelGrid) -> NDArray[np.float64]:
    """Position of a grid's cells minus that in OctoMap, metres (3,), at most half a cell."""
    return np.array(grid.origin) - (_first_key(grid) - CENTER_KEY) * grid.resolution


def _first_key(grid: VoxelGrid) -> NDArray[np.int64]:
    """Key of cell (0, 0, 0)."""
    if grid.dimension != 3:
        raise ValueError(f"OctoMap's files hold 3-D maps, this one is {grid.shape}: use .npz")
    first = np.rint(np.array(grid.origin) / grid.resolution)
    if (np.abs(first) > CENTER_KEY).any() or (first + grid.shape > CENTER_KEY).any():
        raise ValueError(f"{grid} is further from 0 than OctoMap's 32768 voxels")
    return first.astype(np.int64) + CENTER_KEY


def load_octomap(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read an ``.ot`` or ``.bt`` file, of this library or of another program.

    Raises
    ------
    MapFileError
        If the file is missing, broken or truncated, or not of an occupancy tree.
    """
    octomap = import_optional("pyoctomap", "octomap")
    binary = Path(path).suffix.lower() == ".bt"
    settings = _check_header(path, binary)
    tree = octomap.OcTree(0.1)
    if binary:
        tree = tree if tree.readBinary(os.fspath(path)) else None
    else:
        tree = tree.read(os.fspath(path))
    if tree is None or not isinstance(tree, octomap.OcTree):
        raise MapFileError(f"{path}: OctoMap's library cannot read this occupancy tree")
    if settings is None:
        map_ = _empty_bounding_map(path, tree)
    else:
        map_ = map_from_settings(settings, path)
        if not math.isclose(map_.grid.resolution, tree.getResolution(), rel_tol=1e-6):
            raise MapFileError(f"{path}: its comment and its tree have different resolutions")
    log_odds, known = sample_octree(tree, map_.grid)
    clamp = map_.log_odds_range.clamp
    if binary:
        log_odds_fixed = np.where(log_odds >= 0, clamp, -clamp)
    else:
        log_odds_fixed = np.clip(np.rint(log_odds * STEPS_PER_NAT), -clamp, clamp)
    map_.log_odds_fixed[:] = np.where(known, log_odds_fixed, 0).ravel()
    map_.sampled_mask[:] = known.ravel()
    return map_


def sample_octree(tree: Any, grid: VoxelGrid) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Log-odds and known cells of a `pyoctomap.OcTree` on a grid, each of the shape of the grid.

    Its coordinates are those of `to_octree`; leaves beyond the grid are left out.

    Returns
    -------
    log_odds : ndarray of float
        Nats, 0 where nothing is known.
    known : ndarray of bool
    """
    keys, sizes, values = _leaves(tree)
    lower = keys - _first_key(grid)
    upper = np.minimum(lower + sizes[:, None], grid.shape)
    lower = np.maximum(lower, 0)
    log_odds, known = np.zeros(grid.shape), np.zeros(grid.shape, dtype=np.bool_)
    single = (upper - lower == 1).all(axis=1)
    index = tuple(lower[single].T)
    log_odds[index], known[index] = values[single], True
    others = np.flatnonzero(~single & (upper > lower).all(axis=1))
    for (x, y, z), (to_x, to_y, to_z), value in zip(
        lower[others].tolist(), upper[others].tolist(), values[others], strict=True
    ):
        log_odds[x:to_x, y:to_y, z:to_z], known[x:to_x, y:to_y, z:to_z] = value, True
    return log_odds, known


def _check_header(path: str | os.PathLike[str], binary: bool) -> str | None:
    """Map settings in the header, if any; OctoMap itself reads a truncated ``.ot`` as complete."""
    content = read_bytes(path, MapFileError)
    head, found, data = content.partition(b"\ndata\n")
    kind = b"# Octomap OcTree binary file" if binary else b"# Octomap OcTree file"
    lines = head.split(b"\n")
    if not found or not lines[0].startswith(kind):
        raise MapFileError(f"{path} is no {'.bt' if binary else '.ot'} file of OctoMap")
    fields = dict(line.split(b" ", 1) for line in lines if b" " in line and line[:1] != b"#")
    if fields.get(b"id", b"").strip() != b"OcTree" or not fields.get(b"size", b"").isdigit():
        raise MapFileError(f"{path} is not of an occupancy tree: its header says {fields}")
    size = int(fields[b"size"])
    if not binary and len(data) != NODE_BYTES * size:
        raise MapFileError(
            f"{path} is truncated or broken: {size} nodes are {NODE_BYTES * size} bytes, "
            f"not {len(data)}"
        )
    comments = [line for line in lines if line.startswith(COMMENT_PREFIX)]
    return comments[0][len(COMMENT_PREFIX) :].decode(errors="replace") if comments else None


def _leaves(tree: Any) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Lowest keys (k, 3), edges in voxels (k,) and log-odds (k,) of a tree's leaves."""
    resolution, depth = tree.getResolution(), tree.getTreeDepth()
    rows = [
        (*leaf.getCoordinate(), leaf.getDepth(), leaf.current_node.getLogOdds())
        for leaf in tree.begin_leafs()
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    sizes = 1 << (depth - table[:, 3].astype(np.int64))
    lower = table[:, :3] / resolution - 0.5 * sizes[:, None]
    return np.rint(lower).astype(np.int64) + CENTER_KEY, sizes, table[:, 4]


def _empty_bounding_map(path: str | os.PathLike[str], tree: Any) -> OccupancyMap:
    """An empty map of the box around all leaves."""
    keys, sizes, _ = _leaves(tree)
    if len(keys) == 0:
        raise MapFileError(f"{path} holds no voxel, and no comment that says how large the map is")
    lower, resolution = keys.min(axis=0), tree.getResolution()
    shape = tuple(((keys + sizes[:, None]).max(axis=0) - lower).tolist())
    if math.prod(shape) > MAX_CELLS:
        raise MapFileError(f"{path}: its voxels span {shape} cells, too many for a dense map")
    origin = tuple(((lower - CENTER_KEY) * resolution).tolist())
    return OccupancyMap(VoxelGrid(shape, resolution, origin))
