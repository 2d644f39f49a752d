"""What all pictures have in common: colours, and two panels side by side."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional

if TYPE_CHECKING:
    from PIL.Image import Image
    from PIL.ImageDraw import ImageDraw

Color = tuple[int, int, int]
Legend = Sequence[tuple[Sequence[Color], str]]
"""Meaning of each colour or row of colours; the last one is drawn leftmost."""

ROBOT_COLORS: tuple[Color, ...] = (
    (213, 94, 0),
    (0, 114, 178),
    (0, 158, 115),
    (204, 121, 167),
    (230, 159, 0),
    (86, 180, 233),
)
"""Okabe and Ito's palette, safe for colour-blind eyes: vermilion, blue, green, purple, ..."""

FREE: Color = (252, 252, 250)
OCCUPIED: Color = (38, 40, 46)
NEVER_SAMPLED: Color = (143, 160, 184)
"""Distinct from the gray of p = 1/2, and light enough for trails to show."""
NEW_CELL_COLOR: Color = (255, 196, 61)
"""Of cells that the last scans brought, in replays."""

_BACKGROUND: Color = (238, 239, 242)
_TEXT: Color = (45, 48, 56)
_FRAME: Color = (120, 126, 138)

_MARKS: Color = (92, 98, 110)  # of what each robot has in its own colour

_MIN_SLOT_PIXELS = 440  # room for the legend above a narrow map
_PAD = 16
_STRIP = 36
_MARKS_ROW = 28
_ICON = (26, 18)
_SMOOTHING = 4  # icons are drawn this much larger, then averaged down

Icon = Callable[["ImageDraw", int], None]
"""Draws a mark on a cleared image of the size `_ICON`, so many times larger."""
Mark = tuple[Icon, str]
Marks = Sequence[Mark]
"""Meaning of what is drawn on the panels, from left to right."""


def robot_color(robot: int) -> Color:
    """Colour of a robot by its index; the palette repeats after six."""
    return ROBOT_COLORS[robot % len(ROBOT_COLORS)]


def robot_marks(n_robots: int) -> Marks:
    """The colours of a team; robots that share one share an entry."""
    n_colors = len(ROBOT_COLORS)
    if n_robots <= n_colors:
        return [(_disc_icon(robot_color(k)), f"robot_{k}") for k in range(n_robots)]
    shared = [list(range(k, n_robots, n_colors)) for k in range(n_colors)]
    labels = [
        f"robots {', '.join(map(str, robots[:2]))}{', ...' if len(robots) > 2 else ''}"
        if len(robots) > 1
        else f"robot_{robots[0]}"
        for robots in shared
    ]
    return [(_disc_icon(robot_color(k)), label) for k, label in enumerate(labels)]


def _disc_icon(color: Color) -> Icon:
    def draw_disc(draw: "ImageDraw", scale: int) -> None:
        draw.ellipse((7 * scale, 3 * scale, 19 * scale, 15 * scale), fill=color)

    return draw_disc


def wedge_icon(draw: "ImageDraw", scale: int) -> None:
    """The field of view of a planar camera."""
    box = (-16 * scale, -12 * scale, 25 * scale, 29 * scale)
    draw.pieslice(box, -25, 25, fill=(*_MARKS, 75), outline=(*_MARKS, 255), width=scale)


def path_icon(draw: "ImageDraw", scale: int) -> None:
    """Visited positions."""
    knots = [(x * scale, y * scale) for x, y in ((3, 14), (13, 5), (23, 12))]
    draw.line(knots, fill=(*_MARKS, 255), width=round(1.8 * scale), joint="curve")
    for x, y in knots:
        r = 2.7 * scale
        draw.ellipse((x - r, y - r, x + r, y + r), fill=(*_MARKS, 255))


def frustum_icon(draw: "ImageDraw", scale: int) -> None:
    """The pyramid in front of a depth camera."""
    apex, *corners = [
        (x * scale, y * scale) for x, y in ((2, 9), (17, 2), (24, 5), (24, 16), (17, 13))
    ]
    draw.polygon(corners, fill=(*_MARKS, 60))
    for k, corner in enumerate(corners):
        draw.line([apex, corner], fill=(*_MARKS, 255), width=scale)
        draw.line([corner, corners[k - 1]], fill=(*_MARKS, 255), width=scale)


def tint_icon(draw: "ImageDraw", scale: int) -> None:
    """What a depth camera sees."""
    draw.rectangle((3 * scale, 3 * scale, 23 * scale, 15 * scale), fill=(*_MARKS, 107))


PATH_MARK: Mark = (path_icon, "path of the camera")


def side_by_side(
    truth: "Image", team_map: "Image", legend: Legend, caption: str, marks: Marks = ()
) -> NDArray[np.uint8]:
    """Panels side by side with their titles, legend, caption, and the meaning of the marks."""
    width, height = truth.size
    slot = max(width, _MIN_SLOT_PIXELS)
    total = 2 * slot + 3 * _PAD
    rows = _rows_of_marks(marks, total - 2 * _PAD)
    below = _STRIP + _MARKS_ROW * len(rows)
    size = (total, height + _STRIP + below)
    canvas = import_optional("PIL.Image", "render").new("RGB", size, _BACKGROUND)
    draw = import_optional("PIL.ImageDraw", "render").Draw(canvas)
    for column, (panel, title) in enumerate(((truth, "truth"), (team_map, "team map"))):
        left = _PAD + column * (slot + _PAD) + (slot - width) // 2
        canvas.paste(panel, (left, _STRIP))
        draw.rectangle((left - 1, _STRIP - 1, left + width, _STRIP + height), outline=_FRAME)
        slot_left = _PAD + column * (slot + _PAD)
        draw.text((slot_left, _STRIP // 2), title, fill=_TEXT, font=_font(20), anchor="lm")
    _draw_legend(draw, legend, size[0] - _PAD)
    middle = _STRIP + height + _STRIP // 2
    draw.text((_PAD, middle), caption, fill=_TEXT, font=_font(18), anchor="lm")
    for k, row in enumerate(rows):
        _draw_marks(canvas, draw, row, 2 * _STRIP + height + _MARKS_ROW * k)
    return np.array(canvas)


def _mark_width(label: str) -> int:
    return _ICON[0] + 6 + round(_font(17).getlength(label)) + 20


def _rows_of_marks(marks: Marks, width: int) -> list[Marks]:
    """As many marks in a row as have room."""
    rows: list[list[Mark]] = []
    left = width
    for mark in marks:
        needed = _mark_width(mark[1])
        if left + needed > width:
            rows.append([])
            left = 0
        rows[-1].append(mark)
        left += needed
    return list(rows)


def _draw_marks(canvas: "Image", draw: "ImageDraw", marks: Marks, top: int) -> None:
    left, middle = _PAD, top + (_MARKS_ROW - 8) // 2
    for icon, label in marks:
        image = import_optional("PIL.Image", "render").new(
            "RGBA", (_ICON[0] * _SMOOTHING, _ICON[1] * _SMOOTHING), (*_MARKS, 0)
        )
        icon(import_optional("PIL.ImageDraw", "render").Draw(image), _SMOOTHING)
        small = image.reduce(_SMOOTHING)
        canvas.paste(small, (left, middle - _ICON[1] // 2), small)
        at = (left + _ICON[0] + 6, middle)
        draw.text(at, label, fill=_TEXT, font=_font(17), anchor="lm")
        left += _mark_width(label)


def _draw_legend(draw: "ImageDraw", legend: Legend, right: int) -> None:
    """Swatches of the map's colours in the title strip, from the right edge to the left."""
    middle = _STRIP // 2
    for colors, label in legend:
        draw.text((right, middle), label, fill=_TEXT, font=_font(17), anchor="rm")
        right -= round(draw.textlength(label, font=_font(17))) + 22 + 13 * (len(colors) - 1)
        box = (right, middle - 7, right + 13 * len(colors), middle + 7)
        for k, color in enumerate(colors):
            left = right + 13 * k
            draw.rectangle((left, middle - 7, left + 13, middle + 7), fill=color)
        draw.rectangle(box, outline=_FRAME)
        right -= 14


@lru_cache
def _font(size: int) -> Any:
    return import_optional("PIL.ImageFont", "render").load_default(size)
