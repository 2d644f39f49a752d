"""Pictures of field episodes: the true scene at the left, the team's map at the right.

Both panels are taken by the same elevated camera. What a robot's camera sees is tinted in the
robot's colour, on true surfaces at the left and on mapped voxels at the right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.rendering._overlay import Overlay
from coopmap_env.rendering._ray_tracing import FrustumTint, RayTracedScene
from coopmap_env.rendering.meshes import exposed_faces
from coopmap_env.rendering.panels import (
    NEVER_SAMPLED,
    PATH_MARK,
    Color,
    frustum_icon,
    robot_color,
    robot_marks,
    side_by_side,
    tint_icon,
)
from coopmap_env.rendering.view_camera import ViewCamera
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field import FieldWorld

BACKGROUND: Color = (243, 244, 247)
GROUND_COLOR: Color = (236, 234, 229)
TARGET_COLOR: Color = (74, 84, 112)
OBSTACLE_COLORS: tuple[Color, ...] = (
    (196, 178, 148),
    (176, 168, 158),
    (206, 190, 166),
    (158, 150, 142),
)

HEIGHT_COLORS: tuple[Color, ...] = (
    (232, 231, 226),
    (186, 216, 196),
    (114, 184, 174),
    (62, 140, 156),
    (52, 92, 140),
    (62, 46, 110),
)
"""Colors of mapped voxels, from the ground to `MAX_COLOR_HEIGHT` and above."""
MAX_COLOR_HEIGHT = 2.0
"""Metres."""
SAMPLED_FLOOR_COLOR: Color = (214, 221, 230)
"""Color of the floor below voxels that were sampled."""
CHECKER_CONTRAST = 0.022
"""Every other voxel is this much brighter, so that they can be distinguished."""
FLOOR_OFFSET = 0.75
"""Height of the drawn floor above the bottom of the ground's layer, in voxels: the voxels of this
layer appear as tiles."""

LEGEND = (
    ([NEVER_SAMPLED], "never sampled"),
    ([SAMPLED_FLOOR_COLOR], "free"),
    (HEIGHT_COLORS, f"occupied, 0 to {MAX_COLOR_HEIGHT:g} m"),
)
CAMERA_MARKS = (
    (frustum_icon, "camera"),
    (tint_icon, "what it sees"),
    PATH_MARK,
)


@dataclass(frozen=True, eq=False)
class ColoredMesh:
    """Triangles (m, 3, 3) of one colour, metres."""

    triangles: NDArray[np.float64]
    color: Color


def scene_meshes(world: FieldWorld) -> list[ColoredMesh]:
    """The solids of a world in their colours."""
    meshes, n_obstacles = [], 0
    for solid in world.solids:
        if solid.is_ground:
            color = GROUND_COLOR
        elif solid.is_target:
            color = TARGET_COLOR
        else:
            color = OBSTACLE_COLORS[n_obstacles % len(OBSTACLE_COLORS)]
            n_obstacles += 1
        meshes.append(ColoredMesh(solid.triangles, color))
    return meshes


def render_field(
    truth: Sequence[ColoredMesh],
    map_: OccupancyMap,
    robots: Sequence[NDArray[np.float64]],
    cameras: Sequence[Pose],
    camera: DepthCamera,
    view: ViewCamera,
    trails: Sequence[ArrayLike] = (),
    caption: str = "",
    numbers: Sequence[int] | None = None,
    unlocated: Mapping[int, NDArray[np.float64]] | None = None,
) -> NDArray[np.uint8]:
    """Draw the truth and the team map side by side, both with the robots that are located.

    Parameters
    ----------
    truth : sequence of ColoredMesh
        See `scene_meshes`.
    map_ : OccupancyMap
        Voxels with P >= 1/2 are drawn as cubes.
    robots : sequence of array_like (m, 3, 3)
        Triangles of each robot in the world frame; see `robot_triangles`.
    cameras : sequence of Pose
        T_world_camera of each robot.
    camera : DepthCamera
        The depth camera of each robot.
    view : ViewCamera
        The camera of the picture; see `overview_camera`.
    trails : sequence of array_like (k, 3)
        Visited camera positions of each robot, oldest first.
    caption : str
        Line below the pictures.
    numbers : sequence of int, optional
        Index of each robot, which decides its colour; 0, 1, ... if not given.
    unlocated : mapping of int to array_like (m, 3, 3), optional
        Triangles of the other robots by their indices: drawn in the true scene only.

    Returns
    -------
    ndarray of uint8 (height, width, 3)

    Raises
    ------
    ImportError
        If Pillow (extra "render") or embreex (extra "field") is not installed.
    """
    most = max(len(robots), len(cameras), len(trails))
    robot_colors = [robot_color(k) for k in (range(most) if numbers is None else numbers)]
    tints = [
        FrustumTint(pose, camera, color) for pose, color in zip(cameras, robot_colors, strict=False)
    ]
    robot_meshes = [
        ColoredMesh(triangles, color)
        for triangles, color in zip(robots, robot_colors, strict=False)
    ]
    unlocated_meshes = [
        ColoredMesh(triangles, robot_color(k)) for k, triangles in (unlocated or {}).items()
    ]
    panels = []
    for (shapes, colors), shown in (
        (_true_meshes(truth), [*robot_meshes, *unlocated_meshes]),
        (_mapped_meshes(map_), robot_meshes),
    ):
        scene = RayTracedScene(
            [*shapes, *(mesh.triangles for mesh in shown)],
            [*colors, *(mesh.color for mesh in shown)],
            BACKGROUND, view.look_at, (7.0, 11.0),
        )  # fmt: skip
        image, distance = scene.render(view, tints)
        overlay = Overlay(view, distance)
        for trail, color in zip(trails, robot_colors, strict=False):
            overlay.draw_trail(np.asarray(trail, dtype=np.float64), color)
        for tint in tints:
            overlay.draw_frustum(tint)
        panels.append(overlay.composite(image))
    n_robots = 1 + max(
        [*(range(most) if numbers is None else numbers), *(unlocated or {})], default=-1
    )
    return side_by_side(
        panels[0], panels[1], LEGEND, caption, [*robot_marks(n_robots), *CAMERA_MARKS]
    )


def height_colors(heights: ArrayLike) -> NDArray[np.float64]:
    """Colours (n, 3), 0 to 255, of heights (n,) in metres."""
    at = np.clip(np.asarray(heights, dtype=np.float64) / MAX_COLOR_HEIGHT, 0, 1) * (
        len(HEIGHT_COLORS) - 1
    )
    ramp = np.array(HEIGHT_COLORS, dtype=np.float64).T
    return np.stack(
        [np.interp(at, np.arange(len(HEIGHT_COLORS)), channel) for channel in ramp], axis=1
    )


def floor_height(grid: VoxelGrid) -> float:
    """Height in metres of the floor that is drawn below the voxels."""
    ground = np.floor(-grid.origin[2] / grid.resolution)
    return float(grid.origin[2] + (ground + FLOOR_OFFSET) * grid.resolution)


MeshList = tuple[list[NDArray[np.float64]], list[Any]]


def _true_meshes(truth: Sequence[ColoredMesh]) -> MeshList:
    return [mesh.triangles for mesh in truth], [mesh.color for mesh in truth]


def _mapped_meshes(map_: OccupancyMap) -> MeshList:
    """Cubes of the occupied voxels, and a floor that shows which columns were sampled."""
    grid, sampled = map_.grid, map_.sampled
    faces, voxels = exposed_faces(sampled & (map_.log_odds_fixed >= 0).reshape(grid.shape), grid)
    index = np.stack(np.unravel_index(voxels, grid.shape), axis=1)
    checks = 1 + CHECKER_CONTRAST * (index.sum(axis=1) % 2 * 2 - 1)
    colors = height_colors(grid.center(index)[:, 2]) * checks[:, None]
    floor, floor_colors = _floor(np.asarray(sampled.any(axis=2)), grid)
    return [faces, floor], [colors, floor_colors]


def _floor(
    known: NDArray[np.bool_], grid: VoxelGrid
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Triangles (m, 3, 3) of a floor below columns (nx, ny), and their colours (m, 3)."""
    first, last = _runs(known)
    low, high = first, last + 1
    x = np.stack([low[:, 0], high[:, 0], high[:, 0], low[:, 0]], axis=1)
    y = np.stack([low[:, 1], low[:, 1], high[:, 1], high[:, 1]], axis=1)
    corners = np.stack([x, y, np.zeros_like(x)], axis=2) * grid.resolution
    corners += (*grid.origin[:2], floor_height(grid))
    triangles = corners[:, [[0, 1, 2], [0, 2, 3]]].reshape(-1, 3, 3)
    colors = np.where(
        known[tuple(first.T)][:, None], np.array(SAMPLED_FLOOR_COLOR), np.array(NEVER_SAMPLED)
    )
    return triangles, np.repeat(colors, 2, axis=0)


def _runs(flags: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First and last index (n, 2) of each run of equal flags along the second axis."""
    change = flags[:, 1:] != flags[:, :-1]
    first, last = np.ones_like(flags), np.ones_like(flags)
    first[:, 1:], last[:, :-1] = change, change
    return np.argwhere(first), np.argwhere(last)
