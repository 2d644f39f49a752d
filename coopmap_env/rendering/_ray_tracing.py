"""Shaded pictures of coloured triangles, ray traced by Embree.

Light comes from a sky that is brighter above, and from a sun with shadows. Robots' cameras tint
what they see in the colour of the robot.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry import Pose
from coopmap_env.rendering.view_camera import Floats, ViewCamera, dot_rows
from coopmap_env.sensing import DepthCamera

SUN_DIRECTION = np.array([-0.35, -0.25, 0.9], dtype=np.float32)
"""Towards the light, from the viewer's: right, away, up; not a unit vector."""
SUNLIGHT, SKYLIGHT = 0.38, (0.46, 0.66)
"""Brightness by the sun, and by the sky on surfaces that face down and up."""
TINT_STRENGTH = 0.42
"""Fraction of a camera's colour on what it sees."""
RAY_CHUNK = 8192
"""Rays at a time: their intermediate results stay in the processor's cache."""
EDGE_THRESHOLD = 0.06
"""Pixels that differ more than this from a neighbour are sampled at 4 points instead of one."""
SHADOW_OFFSET = 2e-3
"""Metres above a surface at which a ray to the light starts."""


class FrustumTint(NamedTuple):
    """A depth camera that tints what it sees."""

    pose: Pose
    """T_world_camera."""
    camera: DepthCamera
    color: ArrayLike


class Hits(NamedTuple):
    """First intersections of rays."""

    distance: Floats
    """Metres; inf without an intersection."""
    triangle: NDArray[np.int32]
    """-1 without an intersection."""


class RayTracedScene:
    """Coloured triangles, rendered by ray tracing.

    Parameters
    ----------
    triangles : sequence of array_like (m, 3, 3)
        Surfaces, metres.
    colors : sequence of array_like, (3,) or (m, 3)
        Of each surface, or of each of its triangles; 0 to 255.
    background : array_like (3,)
        Colour where there is no surface, and of surfaces far from `center`.
    center : array_like (3,)
        Middle of the scene.
    fade : (float, float)
        Metres from `center` at which surfaces start to fade, and are faded out.

    Raises
    ------
    ImportError
        If embreex is not installed (extra "field").
    """

    def __init__(
        self,
        triangles: Sequence[ArrayLike],
        colors: Sequence[ArrayLike],
        background: ArrayLike,
        center: ArrayLike,
        fade: tuple[float, float],
    ) -> None:
        parts = [np.asarray(part, dtype=np.float32) for part in triangles]
        corners = np.ascontiguousarray(np.concatenate(parts))
        self._colors = np.concatenate(
            [
                np.broadcast_to(np.asarray(color, dtype=np.float32) / 255, (len(part), 3))
                for part, color in zip(parts, colors, strict=True)
            ]
        )
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        self._normals = normals / np.maximum(length, 1e-12)
        self._background: Floats = np.asarray(np.asarray(background) / 255, dtype=np.float32)
        self._center = np.asarray(center, dtype=np.float32)
        self._fade = fade
        self._scene = import_optional("embreex.rtcore_scene", "field").EmbreeScene(robust=True)
        import_optional("embreex.mesh_construction", "field").TriangleMesh(self._scene, corners)

    def intersect(self, origins: Floats, directions: Floats) -> Hits:
        """First intersections of rays (n, 3) of unit directions."""
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions),
            query="INTERSECT", output=True,
        )  # fmt: skip
        nothing = found["primID"] < 0
        return Hits(np.where(nothing, np.float32(np.inf), found["tfar"]), found["primID"])

    def occluded(self, origins: Floats, directions: Floats, lengths: Floats) -> NDArray[np.bool_]:
        """Whether anything lies on rays (n, 3) of given lengths."""
        if not len(lengths):
            return np.empty(0, dtype=np.bool_)
        found = self._scene.run(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions),
            np.array(lengths, dtype=np.float32), query="OCCLUDED",
        )  # fmt: skip
        return np.asarray(found) >= 0

    def render(self, view: ViewCamera, tints: Sequence[FrustumTint]) -> tuple[Floats, Floats]:
        """Colours (height, width, 3) from 0 to 1, and the distance of each pixel (height, width).

        Edges are smooth: where neighbouring pixels differ, four points of the pixel are averaged.
        """
        colors, distance = self._shade(view, view.centers, tints)
        image = colors.reshape(view.height, view.width, 3)
        edge = np.flatnonzero(_edges(image))
        points = view.centers[edge][:, None] + _SUBPIXELS
        fine, _ = self._shade(view, points.reshape(-1, 2), tints)
        colors[edge] = fine.reshape(-1, 4, 3).mean(axis=1)
        return image, distance.reshape(view.height, view.width)

    def _shade(
        self, view: ViewCamera, pixels: Floats, tints: Sequence[FrustumTint]
    ) -> tuple[Floats, Floats]:
        """Colours (n, 3) and distances (n,) at positions (n, 2) in the picture."""
        colors = np.empty((len(pixels), 3), dtype=np.float32)
        distance = np.empty(len(pixels), dtype=np.float32)
        for k in range(0, len(pixels), RAY_CHUNK):
            part = slice(k, k + RAY_CHUNK)
            colors[part], distance[part] = self._shade_chunk(view, pixels[part], tints)
        return colors, distance

    def _shade_chunk(
        self, view: ViewCamera, pixels: Floats, tints: Sequence[FrustumTint]
    ) -> tuple[Floats, Floats]:
        rays = view.rays(pixels)
        eye = np.broadcast_to(np.array(view.eye, dtype=np.float32), rays.shape)
        hits = self.intersect(eye, rays)
        colors: Floats = np.broadcast_to(self._background, rays.shape).copy()
        hit = np.flatnonzero(hits.triangle >= 0)
        rays, triangle = rays[hit], hits.triangle[hit]
        points = eye[hit] + hits.distance[hit, None] * rays
        normals = self._normals[triangle]
        normals = np.where(dot_rows(normals, rays)[:, None] > 0, -normals, normals)
        points = points + SHADOW_OFFSET * normals
        shaded = self._colors[triangle]
        for tint in tints:
            seen = self._visible_points(tint, points, normals)
            color = np.asarray(tint.color, dtype=np.float32) / 255
            shaded[seen] += TINT_STRENGTH * (color - shaded[seen])
        shaded *= self._light(view, points, normals)[:, None]
        far = np.hypot(points[:, 0] - self._center[0], points[:, 1] - self._center[1])
        fraction = np.clip((far - self._fade[0]) / (self._fade[1] - self._fade[0]), 0, 1)[:, None]
        colors[hit] += (1 - fraction * fraction * (3 - 2 * fraction)) * (
            np.minimum(shaded, 1) - self._background
        )
        return colors, hits.distance

    def _light(self, view: ViewCamera, points: Floats, normals: Floats) -> Floats:
        """Brightness of points: that of the sky, and Lambert's of the sun outside of shadows."""
        right, _, back = view.axes
        ahead = np.array([-back[0], -back[1]]) / np.hypot(back[0], back[1])
        sun = np.array(
            [*(SUN_DIRECTION[0] * right[:2] + SUN_DIRECTION[1] * ahead), SUN_DIRECTION[2]],
            dtype=np.float32,
        )
        sun /= np.linalg.norm(sun)
        cosine = np.maximum(normals @ sun, 0)
        facing = np.flatnonzero(cosine)
        to_sun = np.broadcast_to(sun, (len(facing), 3))
        in_shadow = self.occluded(points[facing], to_sun, np.full(len(facing), 1e3))
        cosine[facing[in_shadow]] = 0
        down, up = SKYLIGHT
        light: Floats = down + (up - down) * (normals[:, 2] + 1) / 2 + SUNLIGHT * cosine
        return light

    def _visible_points(
        self, tint: FrustumTint, points: Floats, normals: Floats
    ) -> NDArray[np.int64]:
        """Which points a camera sees: in its field of view and range, and not occluded."""
        camera, t = tint.camera, tint.pose.translation.astype(np.float32)
        ahead, left, up = tint.pose.rotation.T.astype(np.float32)
        indices = np.flatnonzero(
            np.abs(points @ ahead - t @ ahead - camera.far / 2) < camera.far / 2
        )
        for axis, angle in (
            (left, camera.horizontal_field_of_view),
            (up, camera.vertical_field_of_view),
        ):
            # the two planes that bound the field of view
            bound = np.float32(np.tan(angle / 2)) * ahead
            away = points[indices] - t
            indices = indices[(away @ (bound - axis) > 0) & (away @ (bound + axis) > 0)]
        away = points[indices] - t
        distance: Floats = np.sqrt(dot_rows(away, away))
        inside = (distance > camera.near) & (distance < camera.far)
        inside &= dot_rows(away, normals[indices]) < 0
        indices, distance = indices[inside], distance[inside]
        back: Floats = -away[inside] / distance[:, None]
        return indices[~self.occluded(points[indices], back, distance - np.float32(camera.near))]


_SUBPIXELS = np.array(
    [[-0.125, -0.375], [0.375, -0.125], [0.125, 0.375], [-0.375, 0.125]], dtype=np.float32
)
"""A rotated grid: lines near the axes get four shades."""


def _edges(image: Floats) -> NDArray[np.bool_]:
    """Pixels that differ from a neighbour."""
    edge = np.zeros(image.shape[:2], dtype=np.bool_)
    down = (np.abs(image[1:] - image[:-1]) > EDGE_THRESHOLD).any(axis=2)
    right = (np.abs(image[:, 1:] - image[:, :-1]) > EDGE_THRESHOLD).any(axis=2)
    edge[1:] |= down
    edge[:-1] |= down
    edge[:, 1:] |= right
    edge[:, :-1] |= right
    return edge
