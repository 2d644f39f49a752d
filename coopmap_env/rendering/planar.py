"""Pictures of planar episodes: the true world at the left, the team's map at the right.

Positions are in cells: cell ``[i, j]`` covers x in [i, i + 1) and y in [j, j + 1). The picture has
x to the right and y up.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.rendering._planar_window import PlanarWindow, explored_window
from coopmap_env.rendering.panels import (
    FREE,
    NEVER_SAMPLED,
    OCCUPIED,
    PATH_MARK,
    Color,
    robot_color,
    robot_marks,
    side_by_side,
    wedge_icon,
)

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

_PANEL_PIXELS = 600
LEGEND = (([NEVER_SAMPLED], "never sampled"), ([OCCUPIED], "occupied"), ([FREE], "free"))
_INSET_FRACTION = 0.27  # of a panel's longer side
_SMOOTHING = 2  # shapes are drawn this much larger, then averaged down


def render_team(
    truth: ArrayLike,
    probability: ArrayLike,
    sampled: ArrayLike,
    poses: ArrayLike,
    field_of_view: float,
    depth_of_field: float,
    trails: Sequence[ArrayLike] = (),
    caption: str = "",
    min_window: float | None = None,
) -> NDArray[np.uint8]:
    """Draw the truth and the team map side by side, both with the cameras.

    Parameters
    ----------
    truth : array_like of bool (nx, ny)
        Occupied cells of the world.
    probability : array_like of float (nx, ny)
        P(occupied) of the team map; ignored where not sampled.
    sampled : array_like of bool (nx, ny)
        Cells that the team has observed.
    poses : array_like (n, 3)
        Cameras: x and y in cells, heading in radians from x towards y.
    field_of_view : float
        Opening angle of a camera, in radians.
    depth_of_field : float
        Range of a camera, in cells.
    trails : sequence of array_like (k, 2)
        Visited positions of each robot in cells, oldest first.
    caption : str
        Line below the pictures.
    min_window : float, optional
        Show only the explored part of a map with more cells along its longer side than this: a
        window of at least as many, with the whole map in a corner. The whole map by default.

    Returns
    -------
    ndarray of uint8 (height, width, 3)
        RGB. Each panel is about 600 pixels, an integer number of pixels for every cell. The shape
        depends on that of the map and on the number of robots alone.

    Raises
    ------
    ValueError
        If the maps differ in shape or are not planar, or the poses are not (n, 3).
    ImportError
        If Pillow is not installed (extra "render").
    """
    truth, probability, sampled = _planar_maps(truth, probability, sampled)
    poses = np.asarray(poses, dtype=np.float64)
    if poses.ndim != 2 or poses.shape[1] != 3:
        raise ValueError(f"poses must have shape (n, 3), got {poses.shape}")
    known = np.where(sampled, probability, 0.5)
    visited = np.concatenate([poses[:, :2], *(np.reshape(trail, (-1, 2)) for trail in trails)])
    window = PlanarWindow.whole(truth.shape, _PANEL_PIXELS)
    if min_window is not None:
        margin = depth_of_field / 2
        window = explored_window(sampled, visited, margin, min_window, window)
    corner = _emptiest_corner(sampled, window)
    panels = []
    for colors in (
        _shade(truth.astype(np.float64)),
        np.where(sampled[..., None], _shade(known), np.array(NEVER_SAMPLED, dtype=np.uint8)),
    ):
        panel = _Panel(colors, window)
        for robot, pose in enumerate(poses):
            panel.draw_view(pose, field_of_view, depth_of_field, robot_color(robot))
        for robot, trail in enumerate(trails):
            panel.draw_trail(np.asarray(trail, dtype=np.float64), robot_color(robot))
        for robot, pose in enumerate(poses):
            panel.draw_camera(pose, robot_color(robot))
        if not window.is_whole:
            panel.draw_inset(colors, poses[:, :2], corner)
        panels.append(panel.image)
    marks = [
        *robot_marks(max(len(poses), len(trails))),
        (wedge_icon, "field of view"),
        PATH_MARK,
    ]
    return side_by_side(panels[0], panels[1], LEGEND, caption, marks)


class _Panel:
    """A window of one map as an image, and the marks on it; takes positions in cells."""

    def __init__(self, colors: NDArray[np.uint8], window: PlanarWindow) -> None:
        self._window = window
        self.image = _image_of(colors[window.cells]).resize(
            window.resized, import_optional("PIL.Image", "render").Resampling.NEAREST
        )
        left, top = window.cut
        self.image = self.image.crop((left, top, left + window.width, top + window.height))

    def pixels(self, positions: NDArray[np.float64]) -> NDArray[np.float64]:
        """Turn (k, 2) positions in cells to pixels, y down."""
        return self._window.pixels(positions)

    def draw_inset(
        self, colors: NDArray[np.uint8], positions: NDArray[np.float64], corner: tuple[int, int]
    ) -> None:
        """Put the whole map into a corner, with the window and the robots on it.

        The corner is (0 or 1 to the right, 0 or 1 down).
        """
        window, (nx, ny) = self._window, colors.shape[:2]
        factor = _inset_size(window, (nx, ny))[0] / nx
        whole = _image_of(colors).resize(
            _inset_size(window, (nx, ny)), import_optional("PIL.Image", "render").Resampling.BOX
        )
        draw = import_optional("PIL.ImageDraw", "render").Draw(whole)
        x, y, width, height = (factor * value for value in window.extent)
        draw.rectangle(
            (x, factor * ny - y - height, x + width - 1, factor * ny - y - 1),
            outline=(214, 39, 40), width=2,
        )  # fmt: skip
        for robot, (x, y) in enumerate(factor * positions):
            down = factor * ny - y
            box = (x - 3, down - 3, x + 3, down + 3)
            draw.ellipse(box, fill=robot_color(robot), outline=(255, 255, 255))
        right, down = corner
        at = (
            right * (window.width - whole.width - 4) + 2,
            down * (window.height - whole.height - 4) + 2,
        )
        frame = import_optional("PIL.ImageDraw", "render").Draw(self.image)
        edge = (at[0] - 2, at[1] - 2, at[0] + whole.width + 1, at[1] + whole.height + 1)
        frame.rectangle(edge, fill=(255, 255, 255))
        frame.rectangle(edge, outline=(60, 64, 72))
        self.image.paste(whole, at)

    def draw_view(
        self, pose: NDArray[np.float64], field_of_view: float, depth_of_field: float, color: Color
    ) -> None:
        """Tint the wedge that a camera can see in empty space."""
        half = min(field_of_view, 2 * np.pi) / 2
        angles = pose[2] + np.linspace(-half, half, 2 + round(24 * half))
        arc = pose[:2] + depth_of_field * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        wedge = self.pixels(np.vstack([pose[None, :2], arc, pose[None, :2]]))

        def sector(draw: "ImageDraw", at: list[tuple[float, float]]) -> None:
            draw.polygon(at, fill=75)
            draw.line(at, fill=190, width=_SMOOTHING)

        self._stamp(wedge, color, sector)

    def draw_trail(self, trail: NDArray[np.float64], color: Color) -> None:
        """Join the visited positions by a thin line with a dot at each."""
        if len(trail) == 0:
            return

        def path(draw: "ImageDraw", at: list[tuple[float, float]]) -> None:
            draw.line(at, fill=200, width=2 * _SMOOTHING, joint="curve")
            for knot in at:
                _disc(draw, knot, 2.5, fill=230)

        self._stamp(self.pixels(trail), color, path)

    def draw_camera(self, pose: NDArray[np.float64], color: Color) -> None:
        """Put a drop that points along the heading, with a white rim."""
        center = self.pixels(pose[None, :2])[0]
        ahead = np.array([np.cos(pose[2]), -np.sin(pose[2])])
        for fill, radius, length in (((255, 255, 255), 9.0, 20.0), (color, 6.5, 15.0)):
            # the tip's two tangents touch the circle where the cosine is radius / length
            along, across = radius**2 / length, radius * np.sqrt(1 - (radius / length) ** 2)
            side = np.array([-ahead[1], ahead[0]])
            touch = center + along * ahead
            corners = [
                center,
                touch + across * side,
                center + length * ahead,
                touch - across * side,
            ]
            self._stamp(np.stack(corners), fill, _drop(radius))

    def _stamp(
        self,
        points: NDArray[np.float64],
        color: Color,
        draw_mask: Callable[["ImageDraw", Any], None],
    ) -> None:
        """Paint a colour through a smooth mask that `draw_mask` draws around the points.

        Pillow draws without anti-aliasing, so the mask is drawn larger and averaged down; it
        covers the part of the points' bounding box that lies on the panel.
        """
        rim = 10
        low = np.maximum(np.floor(points.min(axis=0)) - rim, 0).astype(int)
        high = np.minimum(np.ceil(points.max(axis=0)) + rim, self.image.size).astype(int)
        width, height = (int(side) for side in high - low)
        if width <= 0 or height <= 0:
            return
        image_module = import_optional("PIL.Image", "render")
        mask = image_module.new("L", (width * _SMOOTHING, height * _SMOOTHING))
        local = [(float(x), float(y)) for x, y in (points - low) * _SMOOTHING]
        draw_mask(import_optional("PIL.ImageDraw", "render").Draw(mask), local)
        self.image.paste(color, (int(low[0]), int(low[1])), mask.reduce(_SMOOTHING))


def _image_of(colors: NDArray[np.uint8]) -> "Image":
    """Colours (nx, ny, 3) as an image, y up."""
    rows = np.ascontiguousarray(colors.transpose(1, 0, 2)[::-1])
    image: Image = import_optional("PIL.Image", "render").fromarray(rows)
    return image


def _inset_size(window: PlanarWindow, shape: tuple[int, int]) -> tuple[int, int]:
    """Pixels of the whole map in a corner."""
    factor = _INSET_FRACTION * max(window.width, window.height) / max(shape)
    return max(round(factor * shape[0]), 1), max(round(factor * shape[1]), 1)


def _emptiest_corner(sampled: NDArray[np.bool_], window: PlanarWindow) -> tuple[int, int]:
    """The corner of a panel whose inset would hide the fewest sampled cells."""
    x, y, width, height = window.extent
    across, up = (
        side / window.scale for side in _inset_size(window, (sampled.shape[0], sampled.shape[1]))
    )
    hidden = {}
    for right, down in ((1, 0), (0, 0), (1, 1), (0, 1)):
        low_x = x + right * (width - across)
        low_y = y + (1 - down) * (height - up)
        part = sampled[
            max(int(low_x), 0) : int(np.ceil(low_x + across)),
            max(int(low_y), 0) : int(np.ceil(low_y + up)),
        ]
        hidden[right, down] = int(part.sum())
    return min(hidden, key=lambda corner: hidden[corner])


def _disc(draw: "ImageDraw", center: tuple[float, float], radius: float, fill: int) -> None:
    """Fill a circle on an enlarged mask; the radius is in pixels of the picture."""
    (x, y), r = center, radius * _SMOOTHING
    draw.ellipse((x - r, y - r, x + r, y + r), fill=fill)


def _drop(radius: float) -> Callable[["ImageDraw", Any], None]:
    """Draw a circle around the first corner and the kite of all four."""

    def draw_drop(draw: "ImageDraw", at: list[tuple[float, float]]) -> None:
        _disc(draw, at[0], radius, fill=255)
        draw.polygon(at, fill=255)

    return draw_drop


def _planar_maps(
    truth: ArrayLike, probability: ArrayLike, sampled: ArrayLike
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_]]:
    cells = np.asarray(truth, dtype=bool)
    known = np.asarray(probability, dtype=np.float64)
    seen = np.asarray(sampled, dtype=bool)
    if not (cells.ndim == 2 and cells.shape == known.shape == seen.shape):
        raise ValueError(
            "truth, probability and sampled must have one shape (nx, ny), "
            f"got {cells.shape}, {known.shape} and {seen.shape}"
        )
    return cells, known, seen


def _shade(probability: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Colours (nx, ny, 3) from free to occupied."""
    ramp = np.linspace(FREE, OCCUPIED, 256).round().astype(np.uint8)
    return ramp[np.rint(np.clip(probability, 0, 1) * 255).astype(np.uint8)]
