"""PLY point clouds of the surface estimates, with their covariances as vertex properties.

Each vertex is the merged surface point of one hit cell: x, y, z, the six numbers of its symmetric
covariance, the cell's occupancy probability and its flat index. Viewers that do not know the
extra properties show the points. Binary files, and ASCII ones with 17 digits, keep every bit.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import read_bytes, write_atomically
from coopmap_env.mapping.files.base import MapFileError
from coopmap_env.mapping.occupancy_map import OccupancyMap

COVARIANCE_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
VERTEX_DTYPE = np.dtype(
    [(axis, "<f8") for axis in "xyz"]
    + [(f"covariance_{pair}", "<f8") for pair in COVARIANCE_PAIRS]
    + [("probability", "<f8"), ("cell", "<i4")]
)
"""One vertex of the files."""
PLY_DTYPES = {
    "char": "<i1", "int8": "<i1", "uchar": "<u1", "uint8": "<u1", "short": "<i2", "int16": "<i2",
    "ushort": "<u2", "uint16": "<u2", "int": "<i4", "int32": "<i4", "uint": "<u4", "uint32": "<u4",
    "float": "<f4", "float32": "<f4", "double": "<f8", "float64": "<f8",
}  # fmt: skip
PLY_TYPE_NAMES = {"<f8": "double", "<i4": "int"}
DIMENSION_COMMENT = "coopmap dimension"
"""Comment with the dimension of the map; in planar maps, z and covariances along z are 0."""


@dataclass(frozen=True)
class SurfaceEstimates:
    """Surface estimates of a map; see `OccupancyMap.surfaces`."""

    cells: NDArray[np.int64]
    """Flat indices (k,)."""
    means: NDArray[np.float64]
    """Merged points (k, D), metres."""
    covariances: NDArray[np.float64]
    """Their merged covariances (k, D, D), square metres."""
    probability: NDArray[np.float64]
    """P(occupied) of their cells (k,)."""

    @classmethod
    def from_map(cls, map_: OccupancyMap) -> SurfaceEstimates:
        """Those of a map."""
        cells, means, covariances = map_.surfaces()
        return cls(cells, means, covariances, map_.probability.ravel()[cells])


def save_surfaces(map_: OccupancyMap, path: str | os.PathLike[str], ascii_: bool = False) -> None:
    """Write the surface estimates of a map.

    Covariances are written as the mean of both triangles, which differ by the rounding of the
    inversion.
    """
    surfaces = SurfaceEstimates.from_map(map_)
    d = map_.grid.dimension
    rows = np.zeros(len(surfaces.cells), dtype=VERTEX_DTYPE)
    for axis, name in enumerate("xyz"[:d]):
        rows[name] = surfaces.means[:, axis]
    for pair in COVARIANCE_PAIRS:
        i, j = "xyz".index(pair[0]), "xyz".index(pair[1])
        if j < d:
            both = surfaces.covariances[:, i, j] + surfaces.covariances[:, j, i]
            rows[f"covariance_{pair}"] = 0.5 * both
    rows["probability"], rows["cell"] = surfaces.probability, surfaces.cells
    lines = [
        "ply",
        f"format {'ascii' if ascii_ else 'binary_little_endian'} 1.0",
        "comment surface points of an occupancy map: metres, covariances in square metres",
        f"comment {DIMENSION_COMMENT} {d}",
        f"element vertex {len(rows)}",
    ]
    lines += [
        f"property {PLY_TYPE_NAMES[VERTEX_DTYPE[name].str]} {name}"
        for name in VERTEX_DTYPE.names or ()
    ]
    header = "\n".join([*lines, "end_header\n"]).encode()
    if ascii_:  # repr of a float is read back as the same float
        body = "".join(" ".join(map(repr, row)) + "\n" for row in rows.tolist()).encode()
    else:
        body = rows.tobytes()
    write_atomically(path, header + body)


def load_surfaces(path: str | os.PathLike[str]) -> SurfaceEstimates:
    """Read surface estimates; other properties and elements of the file are ignored.

    Raises
    ------
    MapFileError
        If the file is missing, broken or truncated, or lacks one of the properties.
    """
    content = read_bytes(path, MapFileError)
    head, found, body = content.partition(b"end_header\n")
    lines = head.decode("ascii", errors="replace").splitlines()
    if not found or not lines or lines[0] != "ply":
        raise MapFileError(f"{path} is no PLY file")
    count, row, dimension = _vertices(path, lines)
    try:
        if "format ascii 1.0" in lines:
            values = [tuple(line.split()) for line in body.decode("ascii").splitlines()[:count]]
            rows = np.array(values, dtype=row)
        elif "format binary_little_endian 1.0" in lines:
            rows = np.frombuffer(body, dtype=row, count=count)
        else:
            raise MapFileError(f"{path}: expected PLY format ascii or binary_little_endian 1.0")
    except (ValueError, TypeError) as error:
        if isinstance(error, MapFileError):
            raise
        raise MapFileError(f"{path} is truncated or broken: {error}") from error
    if len(rows) != count:
        raise MapFileError(f"{path} is truncated: {len(rows)} of {count} vertices")
    return _surfaces(rows, dimension)


def _vertices(path: str | os.PathLike[str], lines: list[str]) -> tuple[int, np.dtype, int]:
    """Number and type of the vertices, which come first, and the map's dimension."""
    elements: list[tuple[str, int]] = []
    fields: list[tuple[str, str]] = []
    dimension = 3
    for line in lines:
        words = line.split()
        if line.startswith(f"comment {DIMENSION_COMMENT}"):
            dimension = 2 if words[-1] == "2" else 3
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdigit():
            elements.append((words[1], int(words[2])))
        elif words[:1] == ["property"] and len(elements) == 1:
            if len(words) != 3 or words[1] not in PLY_DTYPES:
                raise MapFileError(f"{path}: cannot read the vertices' {line!r}")
            fields.append((words[2], PLY_DTYPES[words[1]]))
    if not elements or elements[0][0] != "vertex":
        raise MapFileError(f"{path}: expected element vertex first, got {elements}")
    missing = [name for name in VERTEX_DTYPE.names or () if name not in dict(fields)]
    if missing or len(dict(fields)) != len(fields):
        raise MapFileError(f"{path} lacks the vertex properties {missing} of surface estimates")
    return elements[0][1], np.dtype(fields), dimension


def _surfaces(rows: NDArray[np.void], d: int) -> SurfaceEstimates:
    covariances = np.empty((len(rows), 3, 3))
    for pair in COVARIANCE_PAIRS:
        i, j = "xyz".index(pair[0]), "xyz".index(pair[1])
        covariances[:, i, j] = covariances[:, j, i] = rows[f"covariance_{pair}"]
    means = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=-1)
    return SurfaceEstimates(
        rows["cell"].astype(np.int64),
        means[:, :d].copy(),
        covariances[:, :d, :d].copy(),
        rows["probability"].astype(np.float64),
    )
