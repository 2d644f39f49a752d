"""Pictures of planar and field episodes, and the window that shows them."""

from coopmap_env.rendering.field import (
    HEIGHT_COLORS,
    MAX_COLOR_HEIGHT,
    TARGET_COLOR,
    floor_height,
    height_colors,
    render_field,
    scene_meshes,
)
from coopmap_env.rendering.meshes import cluster_vertices, robot_triangles, simplified_links
from coopmap_env.rendering.panels import ROBOT_COLORS, Color, robot_color
from coopmap_env.rendering.planar import render_team
from coopmap_env.rendering.view_camera import ViewCamera, overview_camera
from coopmap_env.rendering.window import HumanWindow

__all__ = [
    "HEIGHT_COLORS",
    "MAX_COLOR_HEIGHT",
    "ROBOT_COLORS",
    "TARGET_COLOR",
    "Color",
    "HumanWindow",
    "ViewCamera",
    "cluster_vertices",
    "floor_height",
    "height_colors",
    "overview_camera",
    "render_field",
    "render_team",
    "robot_color",
    "robot_triangles",
    "scene_meshes",
    "simplified_links",
]
