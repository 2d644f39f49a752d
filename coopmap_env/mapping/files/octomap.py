"""OctoMap's files, written through OctoMap's own library (extra ``octomap``).

``.ot`` holds the log-odds of every voxel as a 32-bit float. Log-odds in steps of 1/1024 nat are
such floats exactly. A sampled cell with log-odds 0 is a node with 0, a never sampled cell has no
node, so a round trip loses nothing of the occupancy. Surface estimates are not stored: see `npz`
and `ply`. ``.bt`` holds one bit per voxel, occupied from P = 1/2 on; read back, such cells are at
the clamp.

OctoMap's voxels lie at integer multiples of their edge. A grid whose origin does not is written
with a shift of at most half a cell (`octomap_shift`). A comment in the file's header holds the grid
and the map's constants; OctoMap's readers skip it. Files of other programs have no such comment:
the grid is then the bounding box of the known voxels, and log-odds are rounded to fixed point and
clamped. Trees of type ``OcTree``, ``OcTreeStamped`` and ``ColorOcTree`` are read, without colours.
"""

from __future__ import annotations

import math
import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import atomic_path, brief, read_bytes
from coopmap_env.core.limits import check_cells
from coopmap_env.core.yaml_files import read_yaml_number
from coopmap_env.mapping.files._octree_parser import (
    NODE_BYTES,
    Leaves,
    fill_boxes,
    parse_bt,
    parse_ot,
)
from coopmap_env.mapping.files.base import (
    MapFileError,
    errors_naming,
    map_from_settings,
    settings_to_json,
)
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.mapping.log_odds import STEPS_PER_NAT
from coopmap_env.mapping.occupancy_map import OccupancyMap

CENTER_KEY = 1 << 15
"""Key of the voxel whose lower corner is OctoMap's origin; keys are 16 bits."""
COMMENT_PREFIX = b"# coopmap "
RESOLUTION_TOLERANCE = 1e-5
"""Relative difference of two resolutions that are the same: headers state six digits."""


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
    with np.errstate(over="ignore"):
        first = np.rint(np.array(grid.origin) / grid.resolution)
    if (np.abs(first) > CENTER_KEY).any() or (first + grid.shape > CENTER_KEY).any():
        raise ValueError(f"{grid} is further from 0 than OctoMap's 32768 voxels")
    return first.astype(np.int64) + CENTER_KEY


def load_octomap(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read an ``.ot`` or ``.bt`` file, of this library or of another program.

    Raises
    ------
    MapFileError
        If the file is missing, broken or truncated, too large for a dense map, or not of an
        occupancy tree.
    """
    binary = Path(path).suffix.lower() == ".bt"
    content = read_bytes(path, MapFileError)
    with errors_naming(path):
        header, data = _parse_header(content, binary)
        check_cells([header.n_nodes], "the tree")
        if binary:
            leaves = parse_bt(data, header.n_nodes)
        else:
            leaves = parse_ot(data, header.n_nodes, NODE_BYTES[header.tree_type])
        map_ = _make_map(path, header, leaves)
        log_odds, known = _sample_leaves(leaves, map_.grid)
    cells, clamp = np.flatnonzero(known), map_.log_odds_range.clamp
    values = log_odds.ravel()[cells]
    if binary:
        map_.log_odds_fixed[cells] = np.where(values >= 0, clamp, -clamp)
    else:
        map_.log_odds_fixed[cells] = np.clip(np.rint(values * STEPS_PER_NAT), -clamp, clamp)
    map_.sampled_mask[cells] = 1
    return map_


@dataclass(frozen=True)
class _Header:
    tree_type: bytes
    n_nodes: int
    resolution: float
    settings: str | None
    """What `save_octomap` wrote about the map."""


def _parse_header(content: bytes, binary: bool) -> tuple[_Header, bytes]:
    """The header of a file, and the data after it."""
    kind = b"# Octomap OcTree binary file" if binary else b"# Octomap OcTree file"
    end = re.search(rb"^data[ \t]*\r?\n", content, re.MULTILINE)
    if end is None or not content.startswith(kind):
        raise ValueError(f"no {'.bt' if binary else '.ot'} file of OctoMap")
    lines = content[: end.start()].splitlines()
    fields = dict(
        line.split(None, 1) for line in lines if line[:1] != b"#" and len(line.split()) > 1
    )
    tree_type, size = fields.get(b"id", b"").strip(), fields.get(b"size", b"").strip()
    resolution = read_yaml_number(fields.get(b"res", b"").decode("ascii", errors="replace"))
    if tree_type not in NODE_BYTES or not (size.isdigit() and len(size) < 19):
        raise ValueError(f"not of an occupancy tree: its header says {brief(fields)}")
    if not 0 < resolution < math.inf:
        raise ValueError(f"its resolution must be finite and > 0, not {brief(resolution)}")
    comments = [line for line in lines if line.startswith(COMMENT_PREFIX)]
    settings = comments[0][len(COMMENT_PREFIX) :].decode(errors="replace") if comments else None
    return _Header(tree_type, int(size), resolution, settings), content[end.end() :]


def _make_map(path: str | os.PathLike[str], header: _Header, leaves: Leaves) -> OccupancyMap:
    """An empty map: of our settings in the header, or else of the box around all leaves."""
    if header.settings is not None:
        map_ = map_from_settings(header.settings, path)
        resolution = map_.grid.resolution
        if not math.isclose(resolution, header.resolution, rel_tol=RESOLUTION_TOLERANCE):
            raise ValueError("its comment and its tree have different resolutions")
        return map_
    keys, sizes, _ = leaves
    if len(keys) == 0:
        raise ValueError("it holds no voxel, and no comment that says how large the map is")
    lower = keys.min(axis=0)
    shape = tuple(((keys + sizes[:, None]).max(axis=0) - lower).tolist())
    check_cells(shape, f"the box of its voxels, {shape},")
    origin = [int(key - CENTER_KEY) * header.resolution for key in lower]
    return OccupancyMap(VoxelGrid(shape, header.resolution, tuple(origin)))


def sample_octree(tree: Any, grid: VoxelGrid) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Log-odds and known cells of a `pyoctomap.OcTree` on a grid, each of the shape of the grid.

    Its coordinates are those of `to_octree`; leaves beyond the grid are left out.

    Returns
    -------
    log_odds : ndarray of float
        Nats, 0 where nothing is known.
    known : ndarray of bool
    """
    resolution, depth = tree.getResolution(), tree.getTreeDepth()
    rows = [
        (*leaf.getCoordinate(), leaf.getDepth(), leaf.current_node.getLogOdds())
        for leaf in tree.begin_leafs()
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 5)
    sizes = 1 << (depth - table[:, 3].astype(np.int64))
    lower = table[:, :3] / resolution - 0.5 * sizes[:, None]
    keys = np.rint(lower).astype(np.int64) + CENTER_KEY
    return _sample_leaves(Leaves(keys, sizes, table[:, 4]), grid)


def _sample_leaves(
    leaves: Leaves, grid: VoxelGrid
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    lower = leaves.keys - _first_key(grid)
    upper = np.minimum(lower + leaves.sizes[:, None], grid.shape)
    log_odds, known = np.zeros(grid.shape), np.zeros(grid.shape, dtype=np.bool_)
    fill_boxes(np.maximum(lower, 0), upper, leaves.log_odds, log_odds, known)
    return log_odds, known
