"""Figures as SVG: they scale with a page, and show values under the pointer.

A page of a report shows each axis of a figure as a picture of its own, so that they are below each
other where the page is narrow. `save_svg` notes where each axis is; `svg_panels` cuts them out.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import write_atomically

Points = Sequence[float] | NDArray[np.float64]

_READING = "reading: "
"""Start of the id of an invisible marker; the rest is the text under the pointer."""
_NEW_LINE = "\u2028"
"""XML would turn a usual one in an id into a space."""
_VIEW = "data-view"
_POINTS_PER_INCH, _PIXELS_PER_POINT = 72, 96 / 72
_MARGIN = 4.0
"""Points around each axis."""
_SVG, _LINK = "{http://www.w3.org/2000/svg}", "{http://www.w3.org/1999/xlink}href"


def add_readings(
    axis: Any,
    label: str,
    x: Points,
    y: Points,
    low: Points | None = None,
    high: Points | None = None,
    places: Points | None = None,
) -> None:
    """Show values of points under the pointer, with the axis' labels.

    Parameters
    ----------
    axis : Axes
        Of matplotlib; its labels are set.
    label : str
        What the points belong to.
    x, y : sequences of float
        Points in data coordinates.
    low, high : sequences of float, optional
        Ends of the intervals of `y`.
    places : sequence of float, optional
        Where the points are drawn, if not at `x`.
    """
    drawn = x if places is None else places
    for k, (at, value, place) in enumerate(zip(x, y, drawn, strict=True)):
        interval = "" if low is None or high is None else f" [{low[k]:.4g}, {high[k]:.4g}]"
        lines = (
            label,
            f"{axis.get_xlabel()}: {at:.4g}",
            f"{axis.get_ylabel()}: {value:.4g}{interval}",
        )
        add_reading(axis, place, value, lines)


def add_reading(axis: Any, x: float, y: float, lines: Sequence[str]) -> None:
    """Show lines of text where the pointer is at a point (data coordinates)."""
    text = _NEW_LINE.join(line.replace("\n", " ") for line in lines)
    axis.plot([x], [y], "o", alpha=0, gid=_READING + text, zorder=10)


def save_svg(figure: Any, path: Path) -> None:
    """Write a figure of matplotlib as SVG.

    Texts stay texts. Points of `add_readings` become circles with a title, which browsers show.

    Parameters
    ----------
    figure : Figure
    path : Path
        Of the SVG; its stem starts all ids, so that a page can hold several figures.
    """
    settings = {"svg.fonttype": "none", "svg.hashsalt": path.stem, "font.sans-serif": "DejaVu Sans"}
    content = BytesIO()
    with import_optional("matplotlib", "report").rc_context(settings):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(content, format="svg", metadata=nothing)
        views = [_view(figure, part) for part in (*figure.axes, *figure.legends)]
    root = ElementTree.fromstring(content.getvalue())
    for metadata in root.findall(f"{_SVG}metadata"):
        root.remove(metadata)
    for part, view in zip(_parts(root), views, strict=True):
        part.set(_VIEW, view)
    _replace_readings(root)
    _start_ids(root, f"{path.stem}-")
    ElementTree.register_namespace("", _SVG[1:-1])
    write_atomically(path, ElementTree.tostring(root, encoding="unicode") + "\n")


def svg_panels(path: Path) -> list[str]:
    """The axes of a figure that `save_svg` has written, each as an ``<svg>`` of a page.

    Legends of the whole figure come first, each in a ``<div class="legend">``.
    """
    root = ElementTree.fromstring(path.read_text(encoding="utf-8"))
    parts, definitions = _parts(root), root.findall(f"{_SVG}defs")
    legends, panels = [], []
    for k, part in enumerate(parts):
        view = part.attrib.pop(_VIEW)
        width = _PIXELS_PER_POINT * float(view.split()[2])
        # panels stand side by side where they keep most of their size
        style = f"max-width: min(100%, {width:.0f}px); flex-basis: {0.6 * width:.0f}px"
        panel = ElementTree.Element("svg", viewBox=view, width=f"{width:.0f}", style=style)
        # clip paths of all axes are in one place; a page needs them once
        panel.extend([*(definitions if k == 0 else ()), part])
        text = _without_namespaces(panel)
        if "legend_" in part.attrib["id"]:
            legends.append(f'<div class="legend">{text}</div>')
        else:
            panels.append(text)
    return legends + panels


def _view(figure: Any, part: Any) -> str:
    """Box of an axis or a legend as the viewBox of an SVG, in points from the top left."""
    box = part.get_tightbbox() if hasattr(part, "get_tightbbox") else part.get_window_extent()
    scale = _POINTS_PER_INCH / figure.dpi
    x, y = scale * box.x0 - _MARGIN, scale * (figure.bbox.height - box.y1) - _MARGIN
    width, height = (scale * size + 2 * _MARGIN for size in (box.width, box.height))
    return f"{x:.1f} {y:.1f} {width:.1f} {height:.1f}"


def _parts(root: ElementTree.Element) -> list[ElementTree.Element]:
    """Groups of the axes and of the figure's legends, in the order of matplotlib."""
    groups = [group for figure in root.findall(f"{_SVG}g") for group in figure]
    return [
        group for group in groups if re.search(r"(axes|legend)_\d+$", group.attrib.get("id", ""))
    ]


def _replace_readings(root: ElementTree.Element) -> None:
    """Put a circle with a title in the place of each marker of `add_readings`."""
    for group in list(root.iter(f"{_SVG}g")):
        if not group.attrib.get("id", "").startswith(_READING):
            continue
        text = group.attrib.pop("id").removeprefix(_READING).replace(_NEW_LINE, "\n")
        marker = group.find(f".//{_SVG}use")
        for child in list(group):
            group.remove(child)
        if marker is not None:  # there is none where a point is not finite
            place = {"cx": marker.attrib["x"], "cy": marker.attrib["y"], "r": "5"}
            circle = ElementTree.SubElement(
                group, f"{_SVG}circle", {**place, "class": "reading", "fill-opacity": "0"}
            )
            ElementTree.SubElement(circle, f"{_SVG}title").text = text


def _start_ids(root: ElementTree.Element, start: str) -> None:
    for element in root.iter():
        for name, value in element.attrib.items():
            if name == "id":
                element.set(name, start + value)
            elif name == _LINK:
                element.set(name, f"#{start}{value[1:]}")
            else:
                element.set(name, value.replace("url(#", f"url(#{start}"))


def _without_namespaces(root: ElementTree.Element) -> str:
    """An SVG within HTML needs none."""
    for element in root.iter():
        element.tag = element.tag.removeprefix(_SVG)
        if _LINK in element.attrib:
            element.set("href", element.attrib.pop(_LINK))
    return ElementTree.tostring(root, encoding="unicode", short_empty_elements=False)
