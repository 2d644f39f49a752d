"""The trees in OctoMap's files, parsed with bounds.

OctoMap's own library believes a file: a broken ``.ot`` file overflows the stack of the process, a
truncated one passes for a complete one. Here, a tree has 16 levels at most and as many nodes as the
header states, and no byte is read twice.

Both forms are preorder: a node, then its children in ascending order. Child c lies in the upper
half along x if bit 0 of c is set, along y for bit 1, along z for bit 2.

``.ot``
    Per node its log-odds (float32), further values that are skipped (three bytes of colour in a
    ``ColorOcTree``), and one byte of which bit c is set if there is a child c.
``.bt``
    Per inner node 16 bits, from bit 2 c on those of child c: 0 unknown, 1 free, 2 occupied,
    3 an inner node.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import kernel

TREE_DEPTH = 16
"""Levels below the root: keys are 16 bits."""
NODE_BYTES = {b"OcTree": 5, b"OcTreeStamped": 5, b"ColorOcTree": 8}
"""Size of a node in an ``.ot`` file, by the type of the tree."""
_TRUNCATED, _TOO_DEEP = -1, -2


class Leaves(NamedTuple):
    """The leaves of a tree."""

    keys: NDArray[np.int64]
    """Lowest keys (k, 3)."""
    sizes: NDArray[np.int64]
    """Edges in voxels (k,)."""
    log_odds: NDArray[np.float64]
    """Nats (k,); of a ``.bt`` file 1 where occupied and -1 where free."""


def parse_ot(data: bytes, n_nodes: int, node_bytes: int) -> Leaves:
    """The leaves of an ``.ot`` file.

    Parameters
    ----------
    data : bytes
        What follows the header.
    n_nodes, node_bytes : int
        Number of nodes, as the header states it, and their size.

    Raises
    ------
    ValueError
        If the data are of another size, or no tree of 16 levels.
    """
    if len(data) != n_nodes * node_bytes:
        raise ValueError(
            f"truncated or broken: {n_nodes} nodes are {n_nodes * node_bytes} bytes, "
            f"not {len(data)}"
        )
    nodes = np.frombuffer(data, np.uint8).reshape(n_nodes, node_bytes)
    with np.errstate(invalid="ignore"):  # a signalling NaN, which is found below
        log_odds = np.ascontiguousarray(nodes[:, :4]).view("<f4").astype(np.float64).ravel()
    places = np.empty((n_nodes, 4), dtype=np.int32)
    n_read = walk_ot(np.ascontiguousarray(nodes[:, -1]), places) if n_nodes else 0
    _check_walk(n_read, n_nodes)
    leaf = nodes[:, -1] == 0
    if np.isnan(log_odds[leaf]).any():
        raise ValueError("broken: it has log-odds that are no number")
    return Leaves(
        places[leaf, :3].astype(np.int64), places[leaf, 3].astype(np.int64), log_odds[leaf]
    )


def parse_bt(data: bytes, n_nodes: int) -> Leaves:
    """The leaves of a ``.bt`` file; what follows the tree is ignored.

    Raises
    ------
    ValueError
        If the data end too early, or are no tree of 16 levels and of so many nodes.
    """
    # two bytes of an inner node are eight children: a header cannot ask for more memory
    most = min(n_nodes, 4 * len(data) + 1)
    places = np.empty((most, 4), dtype=np.int32)
    occupied = np.empty(most, dtype=np.bool_)
    words = np.frombuffer(data[: len(data) // 2 * 2], "<u2")
    n_read, n_leaves = walk_bt(words, places, occupied) if n_nodes else (0, 0)
    _check_walk(n_read, n_nodes)
    places, log_odds = places[:n_leaves], np.where(occupied[:n_leaves], 1.0, -1.0)
    return Leaves(places[:, :3].astype(np.int64), places[:, 3].astype(np.int64), log_odds)


def _check_walk(n_read: int, n_nodes: int) -> None:
    if n_read == _TOO_DEEP:
        raise ValueError(f"broken: its tree has more than {TREE_DEPTH} levels")
    if n_read == _TRUNCATED:
        raise ValueError("truncated or broken: its tree goes on after its last node")
    if n_read != n_nodes:
        raise ValueError(f"truncated or broken: its tree has {n_read} nodes, not {n_nodes}")


@kernel
def walk_ot(children: NDArray[np.uint8], places: NDArray[np.int32]) -> int:
    """Write lowest key and edge of each node to `places` (n, 4).

    Returns the number of nodes of the tree, or a negative code of what is broken.
    """
    pending = np.zeros(TREE_DEPTH + 1, np.int64)  # bits of the children that are still to come
    keys = np.zeros((TREE_DEPTH + 1, 3), np.int32)
    depth = 0
    for i in range(len(children)):
        edge = 1 << (TREE_DEPTH - depth)
        for axis in range(3):
            places[i, axis] = keys[depth, axis]
        places[i, 3] = edge
        pending[depth] = children[i]
        if depth == TREE_DEPTH and pending[depth]:
            return _TOO_DEEP
        while depth >= 0 and pending[depth] == 0:
            depth -= 1
        if depth < 0:
            return i + 1
        depth = descend(pending, keys, depth)
    return _TRUNCATED


@kernel
def walk_bt(
    words: NDArray[np.uint16], places: NDArray[np.int32], occupied: NDArray[np.bool_]
) -> tuple[int, int]:
    """Write lowest key and edge of each leaf to `places` (n, 4), and whether it is occupied.

    Returns the number of nodes of the tree, or a negative code of what is broken, and the number of
    leaves.
    """
    pending = np.zeros(TREE_DEPTH + 1, np.int64)
    keys = np.zeros((TREE_DEPTH + 1, 3), np.int32)
    depth, n_nodes, n_leaves = 0, 1, 0
    for i in range(len(words)):
        half = 1 << (TREE_DEPTH - 1 - depth)
        for child in range(8):
            code = (np.int64(words[i]) >> (2 * child)) & 3
            if code == 0:
                continue
            n_nodes += 1
            if code == 3:
                pending[depth] |= 1 << child
                continue
            if n_leaves == len(places):
                return _TRUNCATED, 0
            for axis in range(3):
                places[n_leaves, axis] = keys[depth, axis] + ((child >> axis) & 1) * half
            places[n_leaves, 3] = half
            occupied[n_leaves] = code == 2
            n_leaves += 1
        if depth == TREE_DEPTH - 1 and pending[depth]:
            return _TOO_DEEP, 0
        while depth >= 0 and pending[depth] == 0:
            depth -= 1
        if depth < 0:
            return n_nodes, n_leaves
        depth = descend(pending, keys, depth)
    return _TRUNCATED, 0


@kernel
def descend(pending: NDArray[np.int64], keys: NDArray[np.int32], depth: int) -> int:
    """Go to the first pending child of the node at `depth`; its depth."""
    child = 0
    while not (pending[depth] >> child) & 1:
        child += 1
    pending[depth] &= pending[depth] - 1
    half = 1 << (TREE_DEPTH - 1 - depth)
    for axis in range(3):
        keys[depth + 1, axis] = keys[depth, axis] + ((child >> axis) & 1) * half
    return depth + 1


@kernel
def fill_boxes(
    lower: NDArray[np.int64],
    upper: NDArray[np.int64],
    values: NDArray[np.float64],
    log_odds: NDArray[np.float64],
    known: NDArray[np.bool_],
) -> None:
    """Set `log_odds` and `known` (nx, ny, nz) in boxes of cells, from `lower` (k, 3) to `upper`."""
    for k in range(len(values)):
        for x in range(lower[k, 0], upper[k, 0]):
            for y in range(lower[k, 1], upper[k, 1]):
                for z in range(lower[k, 2], upper[k, 2]):
                    log_odds[x, y, z] = values[k]
                    known[x, y, z] = True
