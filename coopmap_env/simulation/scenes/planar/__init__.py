"""Scenes of the planar environment.

=====================  ======================================================================
``"obstacles"``        `Obstacles`: random convex blocks in the open (Figure 7 of the paper)
``"rooms"``            `Rooms`: a random floor of rooms, corridors, doors and furniture
``"corridors"``        `Corridors`: random galleries with dead ends, chambers and loops
``"house"``            `load_house`: a real floor plan, from rtb-data (extra ``data``)
``"….yaml"``           `read_map_server`: a recorded ROS map (extra ``maps``)
=====================  ======================================================================

`make_planar_scene` turns any of these names, or a `PlanarScene` of one's own, into a
`PlanarScene`.
"""

import os
from collections.abc import Callable

from coopmap_env.simulation.scenes.factory import make_scene
from coopmap_env.simulation.scenes.planar.corridors import Corridors
from coopmap_env.simulation.scenes.planar.house import load_house
from coopmap_env.simulation.scenes.planar.map_server import read_map_server
from coopmap_env.simulation.scenes.planar.obstacles import Obstacles
from coopmap_env.simulation.scenes.planar.recorded import RecordedMap, max_pool
from coopmap_env.simulation.scenes.planar.regions import largest_free_region
from coopmap_env.simulation.scenes.planar.rooms import Rooms
from coopmap_env.simulation.scenes.planar.world import PlanarScene, PlanarWorld

__all__ = [
    "PLANAR_SCENES",
    "Corridors",
    "Obstacles",
    "PlanarScene",
    "PlanarWorld",
    "RecordedMap",
    "Rooms",
    "largest_free_region",
    "load_house",
    "make_planar_scene",
    "max_pool",
    "read_map_server",
]

PLANAR_SCENES: dict[str, Callable[[], PlanarScene]] = {
    "obstacles": Obstacles,
    "rooms": Rooms,
    "corridors": Corridors,
    "house": load_house,
}
"""Makers of the scenes with a name. Scenes that are classes can also be made from JSON."""


def make_planar_scene(scene: str | os.PathLike[str] | PlanarScene) -> PlanarScene:
    """Make the scene of a name or a file; a scene is returned as it is.

    Parameters
    ----------
    scene : str, path or PlanarScene
        "obstacles", "rooms", "corridors", "house", or the path of a map_server file (.yaml or
        .yml).

    Raises
    ------
    ValueError
        With the choices, if the name is none of these.
    SceneError
        If the file holds no usable scene.
    ImportError
        With the pip command, if an extra is missing.
    """
    return make_scene(scene, PlanarScene, PLANAR_SCENES, read_map_server)
