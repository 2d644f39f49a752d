"""What all pictures have in common: colours, and two panels side by side."""

from collections.abc import Sequence
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

_MIN_SLOT_PIXELS = 400  # room for the legend above a narrow map
_PAD = 16
_STRIP = 34


def robot_color(robot: int) -> Color:
    """Colour of a robot by its index; the palette repeats after six."""
    return ROBOT_COLORS[robot % len(ROBOT_COLORS)]


def side_by_side(
    truth: "Image", team_map: "Image", legend: Legend, caption: str
) -> NDArray[np.uint8]:
    """Panels side by side with their titles, legend and caption."""
    width, height = truth.size
    slot = max(width, _MIN_SLOT_PIXELS)
    size = (2 * slot + 3 * _PAD, height + 2 * _STRIP)
    canvas = import_optional("PIL.Image", "render").new("RGB", size, _BACKGROUND)
    draw = import_optional("PIL.ImageDraw", "render").Draw(canvas)
    for column, (panel, title) in enumerate(((truth, "truth"), (team_map, "team map"))):
        left = _PAD + column * (slot + _PAD) + (slot - width) // 2
        canvas.paste(panel, (left, _STRIP))
        draw.rectangle((left - 1, _STRIP - 1, left + width, _STRIP + height), outline=_FRAME)
        slot_left = _PAD + column * (slot + _PAD)
        draw.text((slot_left, _STRIP // 2), title, fill=_TEXT, font=_font(19), anchor="lm")
    _draw_legend(draw, legend, size[0] - _PAD)
    draw.text((_PAD, size[1] - _STRIP // 2), caption, fill=_TEXT, font=_font(17), anchor="lm")
    return np.array(canvas)


def _draw_legend(draw: "ImageDraw", legend: Legend, right: int) -> None:
    """Swatches of the map's colours in the title strip, from the right edge to the left."""
    middle = _STRIP // 2
    for colors, label in legend:
        draw.text((right, middle), label, fill=_TEXT, font=_font(15), anchor="rm")
        right -= round(draw.textlength(label, font=_font(15))) + 20 + 13 * (len(colors) - 1)
        box = (right, middle - 6, right + 13 * len(colors), middle + 7)
        for k, color in enumerate(colors):
            left = right + 13 * k
            draw.rectangle((left, middle - 6, left + 13, middle + 7), fill=color)
        draw.rectangle(box, outline=_FRAME)
        right -= 16


@lru_cache
def _font(size: int) -> Any:
    return import_optional("PIL.ImageFont", "render").load_default(size)
