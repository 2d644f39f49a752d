"""Lines over a ray-traced picture: trails and camera frusta."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.rendering._ray_tracing import FrustumTint
from coopmap_env.rendering.panels import Color
from coopmap_env.rendering.view_camera import Floats, ViewCamera

_SMOOTHING = 2  # lines are drawn this much larger, then averaged down
_SEGMENT_LENGTH = 0.06  # metres of a line that are hidden or shown as one
_FRUSTUM_LENGTH = 0.55  # metres of the drawn pyramid of a camera


class Overlay:
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
