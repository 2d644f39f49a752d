"""Report pages: HTML templates with their pictures inside, in one file that loads nothing."""

from __future__ import annotations

import base64
import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.svg import svg_panels
from coopmap_env.evaluation.tables import format_interval

STUDIES = Path(__file__).parents[1]
"""Folder of the templates."""
CONTENTS = "<nav></nav>"
"""Where a template has it, the page gets its contents."""


def render_template(template: str, image_folder: Path, **values: Any) -> str:
    """Fill in the template of a study (extra ``report``); all values are escaped.

    Templates have the filters ``interval`` (`format_interval`); ``two_lines``, the same for narrow
    columns; and ``code``, for text with names between backticks. They have the functions
    ``image(name)``, a PNG file as a data URL; and ``chart(name, alt)``, a figure of `save_chart`
    with each of its axes as an SVG. All tables get boxes in which they scroll. ``<nav></nav>``
    becomes the contents.

    Parameters
    ----------
    template : str
        Path below the folder of the studies, such as ``section3/report.html``.
    image_folder : Path
        Folder of the PNG and SVG files.
    **values
        Variables of the template; a missing one is an error.

    Raises
    ------
    ValueError
        If a picture is not in `image_folder`.
    ImportError
        With the pip command, if Jinja is not installed.
    """
    jinja2 = import_optional("jinja2", "report")
    markupsafe = import_optional("markupsafe", "report")  # comes with Jinja
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(STUDIES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )

    def code(text: str) -> Any:
        pieces = map(markupsafe.escape, text.split("`"))
        marked = [
            piece if k % 2 == 0 else f"<code>{piece}</code>" for k, piece in enumerate(pieces)
        ]
        return markupsafe.Markup("".join(marked))

    def two_lines(values: Any, scale: float = 1.0, digits: int = 2, sign: str = "") -> Any:
        estimate, _, ends = format_interval(values, scale, digits, sign=sign).partition(" [")
        return markupsafe.Markup(f'{estimate}<br><span class="range">[{ends}</span>')

    filters: dict[str, Callable[..., str]] = {
        "interval": format_interval,
        "two_lines": two_lines,
        "code": code,
    }
    environment.filters.update(filters)

    def file(name: str) -> Path:
        if Path(name).name != name:
            raise ValueError(f"a page's picture must be a file in {image_folder}, got {name!r}")
        return image_folder / name

    def image(name: str) -> str:
        return f"data:image/png;base64,{base64.b64encode(file(name).read_bytes()).decode()}"

    def chart(name: str, alt: str) -> Any:
        panels = "\n".join(svg_panels(file(name)))
        label = markupsafe.escape(alt)
        return markupsafe.Markup(
            f'<div class="chart" role="group" aria-label="{label}">{panels}</div>'
        )

    html = environment.get_template(template).render(image=image, chart=chart, **values)
    return with_contents(with_scroll_boxes(html))


def with_scroll_boxes(html: str) -> str:
    """Put each table into a box that scrolls where the table is wider than the page."""
    opened = re.sub(r"<table", '<div class="scroll" tabindex="0"><table', html)
    return opened.replace("</table>", "</table></div>")


def with_contents(html: str) -> str:
    """List all headings where the page has `CONTENTS`; a page without it stays as it is."""
    if CONTENTS not in html:
        return html
    seen: Counter[str] = Counter()
    entries: list[str] = []

    def mark(match: re.Match[str]) -> str:
        level, inside = match.groups()
        text = re.sub(r"<[^>]+>", "", inside)
        name = re.sub(r"\W+", "-", re.sub(r"&\w+;", " ", text).lower()).strip("-")
        seen[name] += 1
        target = name if seen[name] == 1 else f"{name}-{seen[name]}"
        entries.append(f'<li class="level-{level}"><a href="#{target}">{text}</a></li>')
        return f'<h{level} id="{target}">{inside}</h{level}>'

    marked = re.sub(r"<h([23])>(.*?)</h\1>", mark, html, flags=re.DOTALL)
    listed = "\n".join(entries)
    contents = f'<nav aria-label="Contents"><h2>Contents</h2>\n<ul>\n{listed}\n</ul></nav>'
    return marked.replace(CONTENTS, contents)
