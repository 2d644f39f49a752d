"""A field replay as one HTML page with a timeline: the scene by viser, the numbers as an overlay.

viser records what a server would send to its viewers. The page holds that recording and the viewer.
The overlay reads the time of the timeline and shows the numbers at that time. Planar replays have
a page of their own, `planar_page`.
"""

from __future__ import annotations

import json
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import write_atomically
from coopmap_env.evaluation.replay.planar_page import render_planar_page
from coopmap_env.evaluation.replay.planar_recording import PlanarReplay
from coopmap_env.evaluation.replay.recording import Frame, Replay
from coopmap_env.mapping import VoxelGrid
from coopmap_env.rendering import (
    HEIGHT_COLORS,
    MAX_COLOR_HEIGHT,
    TARGET_COLOR,
    Color,
    cluster_vertices,
    floor_height,
    height_colors,
    overview_camera,
    robot_color,
    simplified_links,
)
from coopmap_env.rendering.panels import NEW_CELL_COLOR
from coopmap_env.robots import R_OPTICAL_CAMERA

OVERLAY_TEMPLATE = Path(__file__).with_name("overlay.html")

MOTION_S, PAUSE_S, FINAL_PAUSE_S = 0.8, 0.5, 3.0
"""Seconds on the timeline: of a motion, after each scan, and after the last scan."""
POSES_PER_MOTION = 16
"""Drawn positions of a mount between one pose and the next."""
FRUSTUM_HEIGHT = 0.3
"""Height of a camera's drawn frustum, metres."""
OBSTACLE_COLOR: Color = (150, 146, 140)
TARGET_OPACITY, OBSTACLE_OPACITY = 0.2, 0.15
"""Of the true solids. Nothing else has these opacities: the overlay finds the truth by them."""
VERTEX_TOLERANCE = 1e-4
"""Metres; corners of triangles that are closer to each other become one vertex."""
_CUBE_VERTICES = np.array(
    [[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)]
)
_CUBE_FACES = np.array([
    [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
    [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
])  # fmt: skip


def write_replay(replay: Replay | PlanarReplay, path: Path) -> None:
    """Write one HTML page that works offline.

    Raises
    ------
    ImportError
        If viser is not installed (extra "replay"), which the field's page needs.
    ValueError
        If a planar map is too large for a page.
    """
    if isinstance(replay, PlanarReplay):
        write_atomically(Path(path), render_planar_page(replay))
    else:
        write_atomically(Path(path), render_page(replay))


def render_page(replay: Replay) -> str:
    """The whole page as HTML.

    Raises
    ------
    ImportError
        If viser is not installed (extra "replay").
    """
    viser = import_optional("viser", "replay")
    with redirect_stdout(StringIO()):  # viser prints a greeting in any case
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        page = _record_scene(server, replay)
    finally:
        with redirect_stdout(StringIO()):
            server.stop()
    head, body, tail = page.rpartition("</body>")
    if not body:
        raise RuntimeError("viser's page has no </body> for the overlay: is it another version?")
    return head + _overlay(replay) + body + tail


def scan_times(n_frames: int) -> list[float]:
    """Times at which each frame's scans are in the map, seconds."""
    return [0.0, *(k * MOTION_S + (k - 1) * PAUSE_S for k in range(1, n_frames))]


def voxel_lifetimes(frames: tuple[Frame, ...]) -> dict[tuple[int, int], NDArray[np.int64]]:
    """Voxels by lifetime (first_frame, end_frame): occupied in first_frame <= k < end_frame.

    A voxel that is free in between has several lifetimes.
    """
    cells = np.unique(np.concatenate([frame.occupied for frame in frames]))
    filled = np.zeros((len(frames) + 2, len(cells)), dtype=np.int8)
    for k, frame in enumerate(frames):
        filled[k + 1, np.searchsorted(cells, frame.occupied)] = 1
    change = np.diff(filled, axis=0)
    # both are ordered by voxel: the k-th start belongs to the k-th end
    voxel_index, first_frame = np.nonzero(change.T == 1)
    _, end_frame = np.nonzero(change.T == -1)
    lifetimes = np.stack([first_frame, end_frame], axis=1)
    return {
        (int(b), int(g)): cells[voxel_index[(lifetimes == (b, g)).all(axis=1)]]
        for b, g in np.unique(lifetimes, axis=0)
    }


def _record_scene(server: Any, replay: Replay) -> str:
    scene = server.scene
    view = overview_camera(replay.target, [vehicle.T_world_base for vehicle in replay.vehicles])
    server.initial_camera.position, server.initial_camera.look_at = view.eye, view.look_at
    server.initial_camera.fov = 2 * float(
        np.arctan(np.tan(view.field_of_view / 2) * view.height / view.width)
    )
    scene.set_up_direction("+z")
    # colours fade under the viewer's bright default environment
    scene.configure_environment_map(None)
    scene.add_light_ambient("/light", intensity=0.8)
    _add_static_scene(scene, replay)
    robots = [_RobotNodes(scene, replay, robot) for robot in range(len(replay.vehicles))]
    voxels = _VoxelNodes(scene, replay)
    recording = server.get_scene_serializer()
    for k, frame in enumerate(replay.frames):
        if k:
            for step in range(1, POSES_PER_MOTION + 1):
                recording.insert_sleep(MOTION_S / POSES_PER_MOTION)
                for robot in robots:
                    robot.interpolate(k, step / POSES_PER_MOTION)
        for robot in robots:
            robot.draw_trail(k)
        voxels.show(k)
        recording.insert_sleep(
            FINAL_PAUSE_S if frame is replay.frames[-1] else PAUSE_S if k else 0.0
        )
    page: str = recording.as_html()
    return page


def _add_static_scene(scene: Any, replay: Replay) -> None:
    """Draw the true solids, almost transparent, and a metric grid on the ground."""
    low = np.array(replay.grid.origin)
    size = np.array(replay.grid.shape) * replay.grid.resolution
    scene.add_grid(
        "/ground", width=size[0], height=size[1], cell_size=1.0, section_size=5.0,
        cell_color=(214, 217, 222), section_color=(184, 190, 199), cell_thickness=1.0,
        plane_color=(238, 240, 243), plane_opacity=1.0, shadow_opacity=0.2,
        position=(*(low + size / 2)[:2], floor_height(replay.grid)),
    )  # fmt: skip
    for name, triangles, color, opacity in (
        ("/truth/target", replay.target, TARGET_COLOR, TARGET_OPACITY),
        ("/truth/obstacles", replay.obstacles, OBSTACLE_COLOR, OBSTACLE_OPACITY),
    ):
        if len(triangles):
            vertices, faces = cluster_vertices(triangles, VERTEX_TOLERANCE)
            scene.add_mesh_simple(
                name, vertices, faces, color=color, opacity=opacity, flat_shading=True,
                side="double", cast_shadow=False, receive_shadow=False,
            )  # fmt: skip


class _RobotNodes:
    """The scene nodes of one robot."""

    def __init__(self, scene: Any, replay: Replay, robot: int) -> None:
        self._scene, self._name = scene, f"/robot_{robot}"
        self._vehicle, self._frames = replay.vehicles[robot], replay.frames
        self._robot, self._color = robot, robot_color(robot)
        self._links, self._parts = [], []
        for link, triangles in simplified_links(self._vehicle.chain):
            vertices, faces = cluster_vertices(triangles, VERTEX_TOLERANCE)
            # the link's own name may be "camera" or have a slash, which names a child
            name = f"{self._name}/links/{link}"
            self._links.append(link)
            self._parts.append(
                scene.add_mesh_simple(name, vertices, faces, color=self._color, flat_shading=True)
            )
        camera = replay.camera
        height = np.tan(camera.vertical_field_of_view / 2)
        self._frustum = scene.add_camera_frustum(
            f"{self._name}/camera", fov=camera.vertical_field_of_view,
            aspect=np.tan(camera.horizontal_field_of_view / 2) / height,
            scale=FRUSTUM_HEIGHT, thickness=0.012, color=self._color, variant="filled",
            cast_shadow=False,
        )  # fmt: skip
        self._set_joints(0, 1.0)

    def interpolate(self, k: int, fraction: float) -> None:
        """Move to a fraction of the motion to frame k; slow at both ends."""
        self._set_joints(k, fraction * fraction * (3 - 2 * fraction))

    def _set_joints(self, k: int, fraction: float) -> None:
        start, end = (self._frames[max(j, 0)].joints[self._robot] for j in (k - 1, k))
        if np.array_equal(start, end) and k > 0:
            return
        q = start + fraction * (end - start)
        rotations, translations = self._vehicle.link_poses(q)
        for link, part in zip(self._links, self._parts, strict=True):
            _set_pose(part, rotations[link], translations[link])
        pose = self._vehicle.camera_pose(q)
        _set_pose(self._frustum, pose.rotation @ R_OPTICAL_CAMERA.T, pose.translation)

    def draw_trail(self, k: int) -> None:
        """Draw the camera's path to frame k."""
        if k == 0:
            return
        start, end = (self._frames[j].camera_poses[self._robot].translation for j in (k - 1, k))
        if not np.array_equal(start, end):
            self._scene.add_line_segments(
                f"{self._name}/trail/{k:03}",
                np.array([[start, end]]),
                self._color,
                thickness=0.012,
            )


class _VoxelNodes:
    """The scene nodes of the map's occupied voxels: one node for each lifetime."""

    def __init__(self, scene: Any, replay: Replay) -> None:
        self._scene, self._grid = scene, replay.grid
        self._lifetimes = voxel_lifetimes(replay.frames)
        self._nodes: dict[tuple[int, int], Any] = {}

    def show(self, k: int) -> None:
        """Show the map of frame k, its new voxels in a colour of their own."""
        for (first_frame, end_frame), cells in self._lifetimes.items():
            lifetime = (first_frame, end_frame)
            if end_frame == k:
                self._nodes[lifetime].visible = False
            elif first_frame == k:
                self._nodes[lifetime] = self._add(f"/map/{first_frame:03}_{end_frame:03}", cells)
            elif first_frame == k - 1:
                self._nodes[lifetime].batched_colors = voxel_colors(cells, self._grid)

    def _add(self, name: str, cells: NDArray[np.int64]) -> Any:
        centers = self._grid.center(np.stack(np.unravel_index(cells, self._grid.shape), axis=-1))
        return self._scene.add_batched_meshes_simple(
            name, _CUBE_VERTICES * self._grid.resolution * 0.96, _CUBE_FACES,
            np.broadcast_to([1.0, 0.0, 0.0, 0.0], (len(cells), 4)), centers,
            batched_colors=np.tile(np.array(NEW_CELL_COLOR, dtype=np.uint8), (len(cells), 1)),
            lod="off", flat_shading=True,
        )  # fmt: skip


def voxel_colors(cells: NDArray[np.int64], grid: VoxelGrid) -> NDArray[np.uint8]:
    """Colours (n, 3) of voxels by their height."""
    heights = grid.origin[2] + (cells % grid.shape[2] + 0.5) * grid.resolution
    return height_colors(heights).round().astype(np.uint8)


def _set_pose(node: Any, rotation: NDArray[np.float64], translation: NDArray[np.float64]) -> None:
    from scipy.spatial.transform import Rotation

    node.wxyz = np.roll(Rotation.from_matrix(rotation).as_quat(), 1)
    node.position = translation


def _overlay(replay: Replay) -> str:
    """The overlay's HTML with the numbers, and the script that follows the timeline."""
    frames = replay.frames
    data = {
        "title": replay.title,
        "times": scan_times(len(frames)),
        "observed_fraction": [round(frame.observed_fraction, 5) for frame in frames],
        "voxels": [len(frame.occupied) for frame in frames],
        "rewards": [[round(value, 4) for value in frame.rewards] for frame in frames],
        "notes": [list(frame.notes) for frame in frames],
        "colors": [f"rgb{robot_color(k)}" for k in range(len(replay.vehicles))],
        "heights": [f"rgb{color}" for color in HEIGHT_COLORS],
        "max_height": MAX_COLOR_HEIGHT,
        "new": f"rgb{NEW_CELL_COLOR}",
        "truth_opacities": [TARGET_OPACITY, OBSTACLE_OPACITY],
    }
    # within a script, "<" could end it ("</script>") or hide its end ("<!--<script>")
    text = json.dumps(data).replace("<", "\\u003c")
    return OVERLAY_TEMPLATE.read_text(encoding="utf-8").replace("/*DATA*/", text)
