"""Recorded maps as scenes: a ROS map_server YAML file and the image that it names.

How gray values become occupancies is described in `coopmap_env.mapping.files.map_server_image`. A
cell is free where its occupancy is at most ``free_thresh``, in mode raw too. All other cells count
as occupied in the world's truth, unknown ones too: nothing is known to be free there, so no robot
may start there or be credited for seeing beyond.
"""

import os
from pathlib import Path

from coopmap_env.mapping.files import MapFileError, read_map_server_image
from coopmap_env.simulation.scenes.factory import SceneError
from coopmap_env.simulation.scenes.planar.recorded import RecordedMap, max_pool
from coopmap_env.simulation.scenes.planar.world import PlanarWorld


def read_map_server(path: str | os.PathLike[str], pool: int = 1) -> RecordedMap:
    """Read a recorded map.

    Parameters
    ----------
    path : path
        The YAML file.
    pool : int
        Pixels per side of a cell: a cell is occupied if any of its pixels is, and the resolution
        grows by this factor.

    Returns
    -------
    RecordedMap
        Named after the file.

    Raises
    ------
    SceneError
        If a file is missing, unreadable or no usable world.
    ImportError
        With the pip command, if PyYAML or Pillow is not installed.
    """
    path = Path(path)
    try:
        image = read_map_server_image(path)
    except MapFileError as error:
        raise SceneError(str(error)) from error
    fields = image.fields
    occupied = max_pool(~image.free, pool)
    try:
        world = PlanarWorld(occupied, fields.resolution * pool, fields.origin, path.stem)
    except (ValueError, OverflowError, MemoryError) as error:
        raise SceneError(
            f"{path}: image {str(fields.image)!r:.300} makes no world: {error}"
        ) from error
    return RecordedMap(world)
