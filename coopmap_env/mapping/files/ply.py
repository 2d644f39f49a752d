"""PLY point clouds of the surface estimates, with their covariances as vertex properties.

Each vertex is the merged surface point of one hit cell: x, y, z, the six numbers of its symmetric
covariance, the cell's occupancy probability and its flat index. Viewers that do not know the
extra properties show the points. Binary files, and ASCII ones with 17 digits, keep every bit.
Files of other programs may have line ends of Windows or old Macs, and either order of bytes.
"""

from __future__ import annotations

import io
import os
import re
from dataclasses import dataclass
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import brief, read_bytes, write_atomically
from coopmap_env.core.limits import check_cells
from coopmap_env.geometry.mesh_formats.ply_header import PLY_TYPES, split_header
from coopmap_env.mapping.files.base import MapFileError, errors_naming
from coopmap_env.mapping.occupancy_map import OccupancyMap

COVARIANCE_PAIRS = ("xx", "xy", "xz", "yy", "yz", "zz")
VERTEX_DTYPE = np.dtype(
    [(axis, "<f8") for axis in "xyz"]
    + [(f"covariance_{pair}", "<f8") for pair in COVARIANCE_PAIRS]
    + [("probability", "<f8"), ("cell", "<i4")]
)
"""One vertex of the files."""
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
        If the file is missing, broken, truncated or too large, lacks one of the properties, or has
        values that are no surface estimates.
    """
    content = read_bytes(path, MapFileError)
    with errors_naming(path):
        header, body = split_header(content)
        form, count, row, dimension = _parse_header(header)
        check_cells([count], "element vertex")
        return _surfaces(_read_rows(form, body, row, count), dimension)


def _parse_header(lines: list[str]) -> tuple[str, int, np.dtype, int]:
    """Format, number and type of the vertices, which come first, and the map's dimension."""
    form, dimension = "", 3
    elements: list[tuple[str, int]] = []
    fields: list[tuple[str, str]] = []
    for line in lines:
        words = line.split()
        if words[:3] == ["comment", *DIMENSION_COMMENT.split()]:
            dimension = 2 if words[-1] == "2" else 3
        elif words[:1] == ["format"]:
            form = " ".join(words[1:])
        elif words[:1] == ["element"]:
            if len(words) != 3 or not re.fullmatch(r"[0-9]{1,18}", words[2]):
                raise ValueError(f"cannot read {brief(line)}")
            elements.append((words[1], int(words[2])))
        elif words[:1] == ["property"] and len(elements) == 1:
            if len(words) != 3 or words[1] not in PLY_TYPES:
                raise ValueError(f"cannot read the vertices' {brief(line)}")
            fields.append((words[2], f"<{PLY_TYPES[words[1]]}"))
    if not elements or elements[0][0] != "vertex":
        raise ValueError(f"expected element vertex first, got {brief(elements)}")
    missing = [name for name in VERTEX_DTYPE.names or () if name not in dict(fields)]
    if missing:
        raise ValueError(f"it lacks the vertex properties {missing} of surface estimates")
    if len(dict(fields)) != len(fields):
        raise ValueError("two of its vertex properties have the same name")
    return form, elements[0][1], np.dtype(fields), dimension


def _read_rows(form: str, body: bytes, row: np.dtype, count: int) -> NDArray[np.void]:
    if form == "ascii 1.0":
        text = io.StringIO(body.decode("ascii"), newline=None)
        lines = list(islice((line for line in text if line.strip()), count))
        rows = np.loadtxt(lines, row, comments=None, ndmin=1) if lines else np.zeros(0, row)
    elif form in ("binary_little_endian 1.0", "binary_big_endian 1.0"):
        row = row.newbyteorder("<" if "little" in form else ">")
        n_whole = min(count, len(body) // row.itemsize)
        rows = np.frombuffer(body, row, n_whole)
    else:
        raise ValueError(f"expected a PLY format ascii or binary of version 1.0, not {brief(form)}")
    if len(rows) != count:
        raise ValueError(f"it is truncated: {len(rows)} of {count} vertices")
    return np.asarray(rows)


def _surfaces(rows: NDArray[np.void], d: int) -> SurfaceEstimates:
    covariances = np.empty((len(rows), 3, 3))
    with np.errstate(invalid="ignore"):  # a signalling NaN of 4 bytes, which is found below
        for pair in COVARIANCE_PAIRS:
            i, j = "xyz".index(pair[0]), "xyz".index(pair[1])
            covariances[:, i, j] = covariances[:, j, i] = rows[f"covariance_{pair}"]
        means = np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=-1)
        probability = rows["probability"].astype(np.float64)
    if not (np.isfinite(means).all() and np.isfinite(covariances).all()):
        raise ValueError("its points and covariances must be finite")
    if not ((probability >= 0) & (probability <= 1)).all():
        raise ValueError("the probability of each vertex must lie in [0, 1]")
    if rows["cell"].dtype.kind not in "iu" or (rows["cell"] < 0).any():
        raise ValueError("the cell of each vertex must be an integer of at least 0")
    return SurfaceEstimates(
        rows["cell"].astype(np.int64),
        means[:, :d].copy(),
        covariances[:, :d, :d].copy(),
        probability,
    )
