"""Maps in files: one module per format, and one front that chooses by the file's suffix.

==============  ==========  ======================================================================
suffix          dimensions  what a round trip keeps
==============  ==========  ======================================================================
``.npz``        2, 3        everything, bit for bit
``.ot``         3           occupancy, sampled cells, grid and constants, exactly; no surfaces
``.bt``         3           free or occupied for every sampled cell (OctoMap's maximum likelihood)
``.ply``        2, 3        surface means and covariances, bit for bit; see `load_surfaces`
``.yaml .yml``  2           free, occupied or unknown (ROS map_server)
==============  ==========  ======================================================================

Each file appears under its name only when it is complete. A file that cannot be read raises
`MapFileError`, a ValueError that names it.
"""

from __future__ import annotations

import os
from pathlib import Path

from coopmap_env.mapping.files.base import MapFileError
from coopmap_env.mapping.files.map_server import load_map_server, save_map_server, write_map_server
from coopmap_env.mapping.files.map_server_image import (
    MapServerFields,
    MapServerImage,
    read_map_server_image,
)
from coopmap_env.mapping.files.npz import load_npz, save_npz
from coopmap_env.mapping.files.octomap import load_octomap, save_octomap
from coopmap_env.mapping.files.ply import SurfaceEstimates, load_surfaces, save_surfaces
from coopmap_env.mapping.occupancy_map import OccupancyMap

SAVERS = {
    ".npz": save_npz,
    ".ot": save_octomap,
    ".bt": save_octomap,
    ".ply": save_surfaces,
    ".yaml": save_map_server,
    ".yml": save_map_server,
}
LOADERS = {
    ".npz": load_npz,
    ".ot": load_octomap,
    ".bt": load_octomap,
    ".yaml": load_map_server,
    ".yml": load_map_server,
}


def save_map(map_: OccupancyMap, path: str | os.PathLike[str]) -> None:
    """Write a map in the format that the suffix names; an existing file is replaced.

    Raises
    ------
    ValueError
        If the suffix is not in the table above, or the format cannot hold the map.
    ImportError
        With the pip command, if the format's library is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in SAVERS:
        raise ValueError(f"maps are written as {', '.join(SAVERS)}, not {str(path)!r}")
    SAVERS[suffix](map_, path)


def load_map(path: str | os.PathLike[str]) -> OccupancyMap:
    """Read a map in the format that the suffix names.

    Raises
    ------
    MapFileError
        If the file is missing, broken, truncated or too large, or its suffix is not in the table
        above or holds surfaces only (``.ply``).
    ImportError
        With the pip command, if the format's library is not installed.
    """
    suffix = Path(path).suffix.lower()
    if suffix == ".ply":
        raise MapFileError(f"{path}: surface estimates are no map: use load_surfaces")
    if suffix not in LOADERS:
        raise MapFileError(f"{path}: maps are read from {', '.join(LOADERS)}, not {suffix!r}")
    return LOADERS[suffix](path)


__all__ = [
    "MapFileError",
    "MapServerFields",
    "MapServerImage",
    "SurfaceEstimates",
    "load_map",
    "load_map_server",
    "load_npz",
    "load_octomap",
    "load_surfaces",
    "read_map_server_image",
    "save_map",
    "save_map_server",
    "save_npz",
    "save_octomap",
    "save_surfaces",
    "write_map_server",
]
