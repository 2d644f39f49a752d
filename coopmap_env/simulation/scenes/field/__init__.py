"""Scenes of the field environment.

=================  ==========================================================================
``"worksite"``     `Worksite`: a solar panel of known geometry among rocks and crates
``"clutter"``      `Clutter`: tables, shelves and objects of pybullet_data (extra ``field``)
``"rubble"``       `Rubble`: a dense pile of blocks that hide each other
``"occluded"``     `Occluded`: the solar panel behind screens, the vehicles on one side
``"….yaml"``       `read_user_scene`: meshes, URDFs and boxes of one's own (extra ``maps``)
=================  ==========================================================================

`make_field_scene` turns any of these names, or a `FieldScene` of one's own, into a `FieldScene`.
"""

import os
from collections.abc import Callable

from coopmap_env.simulation.scenes.factory import make_scene
from coopmap_env.simulation.scenes.field.base_poses import BasePlacement
from coopmap_env.simulation.scenes.field.clutter import Clutter
from coopmap_env.simulation.scenes.field.occluded import Occluded
from coopmap_env.simulation.scenes.field.rubble import Rubble
from coopmap_env.simulation.scenes.field.solid import (
    Solid,
    box_corners,
    solid_from_boxes,
    solid_from_hull,
)
from coopmap_env.simulation.scenes.field.user_file import read_user_scene
from coopmap_env.simulation.scenes.field.user_scene import UserScene
from coopmap_env.simulation.scenes.field.worksite import Worksite, target_solids
from coopmap_env.simulation.scenes.field.world import (
    BASE_CLEARANCE,
    FIELD_GRID,
    FieldScene,
    FieldWorld,
    make_ground,
)

__all__ = [
    "BASE_CLEARANCE",
    "FIELD_GRID",
    "FIELD_SCENES",
    "BasePlacement",
    "Clutter",
    "FieldScene",
    "FieldWorld",
    "Occluded",
    "Rubble",
    "Solid",
    "UserScene",
    "Worksite",
    "box_corners",
    "make_field_scene",
    "make_ground",
    "read_user_scene",
    "solid_from_boxes",
    "solid_from_hull",
    "target_solids",
]

FIELD_SCENES: dict[str, Callable[[], FieldScene]] = {
    "worksite": Worksite,
    "clutter": Clutter,
    "rubble": Rubble,
    "occluded": Occluded,
}
"""Makers of the scenes with a name. Scenes that are classes can also be made from JSON."""


def make_field_scene(scene: str | os.PathLike[str] | FieldScene) -> FieldScene:
    """Make the scene of a name or a file; a scene is returned as it is.

    Parameters
    ----------
    scene : str, path or FieldScene
        "worksite", "clutter", "rubble", "occluded", or the path of a scene's file (.yaml or
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
    return make_scene(scene, FieldScene, FIELD_SCENES, read_user_scene)
