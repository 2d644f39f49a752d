"""Report pages: HTML templates with their pictures inside."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional
from coopmap_env.evaluation.tables import format_interval

STUDIES = Path(__file__).parents[1]
"""Folder of the templates."""


def render_template(template: str, image_folder: Path, **values: Any) -> str:
    """Fill in the template of a study (extra ``report``); all values are escaped.

    Templates have the filters ``interval`` (`format_interval`) and ``code``, for text with names
    between backticks; and the function ``image(name)``, which puts a PNG file into the page.

    Parameters
    ----------
    template : str
        Path below the folder of the studies, such as ``section3/report.html``.
    image_folder : Path
        Folder of the PNG files.
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

    filters: dict[str, Callable[..., str]] = {"interval": format_interval, "code": code}
    environment.filters.update(filters)

    def image(name: str) -> str:
        if Path(name).name != name:
            raise ValueError(f"a page's picture must be a file in {image_folder}, got {name!r}")
        data = base64.b64encode((image_folder / name).read_bytes()).decode()
        return f"data:image/png;base64,{data}"

    html: str = environment.get_template(template).render(image=image, **values)
    return html
