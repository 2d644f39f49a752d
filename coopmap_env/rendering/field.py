"""Pictures of a team in the field: the worksite at the left, what the team knows at the right.

Both panels are seen by the same elevated camera. What a robot's camera sees is tinted in the
robot's colour, on true surfaces at the left and on mapped voxels at the right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.rendering.meshes import exposed_faces
from coopmap_env.rendering.panels import NEVER_SAMPLED, Color, robot_color, side_by_side
from coopmap_env.rendering.ray_tracing import Floats, FrustumTint, RayTracedScene, ViewCamera
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
"""Of mapped voxels, from the ground to `MAX_COLOR_HEIGHT` metres and more."""
MAX_COLOR_HEIGHT = 2.0
SAMPLED_FLOOR_COLOR: Color = (214, 221, 230)
"""Of the floor below voxels that were sampled."""
CHECKER_CONTRAST = 0.022
"""Every other voxel is this much brighter, so that they can be told apart."""
FLOOR_OFFSET = 0.75
"""Voxels above the bottom of the ground's layer: its voxels stand out as tiles, and no more."""

LEGEND = (
    ([NEVER_SAMPLED], "never sampled"),
    ([SAMPLED_FLOOR_COLOR], "free"),
    (HEIGHT_COLORS, f"occupied, 0 to {MAX_COLOR_HEIGHT:g} m"),
)

PANEL_SIZE = (600, 440)
"""Pixels."""
FIELD_OF_VIEW = np.radians(38.0)
ELEVATION = np.radians(40.0)
_SMOOTHING = 2  # lines are drawn this much larger, then averaged down
_SEGMENT_LENGTH = 0.06  # metres of a line that are hidden or shown as one
_FRUSTUM_LENGTH = 0.55  # metres of the drawn pyramid of a camera


@dataclass(frozen=True, eq=False)
class ColoredMesh:
    """Triangles (m, 3, 3) of one colour, metres."""

    triangles: NDArray[np.float64]
    color: Color


def scene_meshes(world: FieldWorld) -> list[ColoredMesh]:
    """The solids of a world in the colours of pictures."""
    surfaces, others = [], 0
    for solid in world.solids:
        if solid.is_ground:
            color = GROUND_COLOR
        elif solid.is_target:
            color = TARGET_COLOR
        else:
            color = OBSTACLE_COLORS[others % len(OBSTACLE_COLORS)]
            others += 1
        surfaces.append(ColoredMesh(solid.triangles, color))
    return surfaces


def overview_camera(target: ArrayLike, bases: Sequence[Pose]) -> ViewCamera:
    """Look at a target's triangles (m, 3, 3) through the widest gap between the vehicles."""
    corners = np.asarray(target, dtype=np.float64).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle = (low + high) / 2
    base_positions = np.array([base.translation for base in bases])
    around = np.sort(np.arctan2(*(base_positions - middle)[:, 1::-1].T))
    gaps = np.diff(around, append=around[0] + 2 * np.pi)
    azimuth = around[np.argmax(gaps)] + gaps.max() / 2
    box = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    corner = np.array([[x, y, z] for x in (-0.9, 0.9) for y in (-0.9, 0.9) for z in (0.0, 1.9)])
    shown = np.concatenate([box, *(base_position + corner for base_position in base_positions)])
    look_at = (shown.min(axis=0) + shown.max(axis=0)) / 2
    back = np.array([np.cos(azimuth), np.sin(azimuth), np.tan(ELEVATION)])
    view = ViewCamera(tuple(look_at + back), tuple(look_at), FIELD_OF_VIEW, *PANEL_SIZE)
    right, up, towards = view.axes @ (shown - look_at).T
    tangent = np.tan(FIELD_OF_VIEW / 2)
    needed = (
        np.maximum(np.abs(right), np.abs(up) * PANEL_SIZE[0] / PANEL_SIZE[1]) / tangent + towards
    )
    eye = look_at + back / np.linalg.norm(back) * max(float(needed.max()), 1.0)
    return ViewCamera(tuple(eye), tuple(look_at), FIELD_OF_VIEW, *PANEL_SIZE)


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
    truth : sequence of Surface
        See `scene_meshes`.
    map_ : OccupancyMap
        Voxels with P >= 1/2 are drawn as cubes.
    robots : sequence of array_like (m, 3, 3)
        Triangles of each robot in the world frame; see `robot_triangles`.
    cameras : sequence of Pose
        T_world_camera of each robot.
    camera : DepthCamera
        What each of them sees.
    view : Overview
        Where the picture is taken from; see `overview_camera`.
    trails : sequence of array_like (k, 3)
        Visited camera positions of each robot, oldest first.
    caption : str
        Line below the pictures.
    numbers : sequence of int, optional
        Which robot each of them is, which decides its colour; from 0 on, if not given.
    unlocated : mapping of int to array_like (m, 3, 3), optional
        Triangles of robots that the team does not know of, by their numbers: in the truth alone.

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
        overlay = _Overlay(view, distance)
        for trail, color in zip(trails, robot_colors, strict=False):
            overlay.draw_trail(np.asarray(trail, dtype=np.float64), color)
        for tint in tints:
            overlay.draw_frustum(tint)
        panels.append(overlay.composite(image))
    return side_by_side(panels[0], panels[1], LEGEND, caption)


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
    return [surface.triangles for surface in truth], [surface.color for surface in truth]


def _mapped_meshes(map_: OccupancyMap) -> MeshList:
    """Cubes of the occupied voxels, and below them a floor that says which columns were sampled."""
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


class _Overlay:
    """Lines over a picture; what is behind a surface is drawn fainter."""

    def __init__(self, view: ViewCamera, distance: Floats) -> None:
        self._view, self._distance = view, distance
        size = (view.width * _SMOOTHING, view.height * _SMOOTHING)
        self._layer = import_optional("PIL.Image", "render").new("RGBA", size)
        self._draw = import_optional("PIL.ImageDraw", "render").Draw(self._layer)

    def draw_trail(self, points: NDArray[np.float64], color: Color) -> None:
        """Join visited positions by a line with a knot at each."""
        for start, end in pairwise(points):
            self._line(start, end, color, 1.6, 0.85)
        at, _ = self._view.project(points)
        for x, y in at * _SMOOTHING:
            r = 2.6 * _SMOOTHING
            self._draw.ellipse((x - r, y - r, x + r, y + r), fill=(*color, 235))

    def draw_frustum(self, tint: FrustumTint) -> None:
        """Outline the pyramid in front of a camera."""
        camera = tint.camera
        left = np.tan(camera.horizontal_field_of_view / 2)
        up = np.tan(camera.vertical_field_of_view / 2)
        signs = ((1, 1), (-1, 1), (-1, -1), (1, -1))
        corners = tint.pose.transform([[1, y * left, z * up] for y, z in signs])
        apex = tint.pose.translation
        corners = apex + _FRUSTUM_LENGTH * (corners - apex)
        color: Color = tuple(np.asarray(tint.color).tolist())
        at, _ = self._view.project(corners)
        self._draw.polygon([(x, y) for x, y in (at * _SMOOTHING).tolist()], fill=(*color, 60))
        for k, corner in enumerate(corners):
            self._line(apex, corner, color, 1.4, 1.0)
            self._line(corner, corners[k - 1], color, 1.4, 1.0)

    def _line(
        self, start: NDArray[np.float64], end: NDArray[np.float64], color: Color,
        width: float, strength: float,
    ) -> None:  # fmt: skip
        n = max(int(np.linalg.norm(end - start) / _SEGMENT_LENGTH), 1)
        points = start + np.linspace(0, 1, n + 1)[:, None] * (end - start)
        at, depth = self._view.project(points)
        columns = np.clip(at[:, 0].astype(int), 0, self._view.width - 1)
        rows = np.clip(at[:, 1].astype(int), 0, self._view.height - 1)
        hidden = depth > self._distance[rows, columns] + 0.05
        for k in range(n):
            faint = 0.35 if hidden[k] and hidden[k + 1] else 1.0
            fill = (*color, round(255 * strength * faint))
            segment = [tuple(p) for p in (at[k : k + 2] * _SMOOTHING).tolist()]
            self._draw.line(segment, fill=fill, width=round(width * _SMOOTHING))

    def composite(self, image: Floats) -> Any:
        """The picture with the lines on it."""
        image_module = import_optional("PIL.Image", "render")
        base = image_module.fromarray(np.rint(image * 255).astype(np.uint8)).convert("RGBA")
        return image_module.alpha_composite(base, self._layer.reduce(_SMOOTHING)).convert("RGB")
