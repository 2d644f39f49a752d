"""Report pages: templates filled in, with their pictures inside (extra ``report``)."""

from __future__ import annotations

import base64
from collections.abc import Callable
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional

STUDIES = Path(__file__).parents[1]
"""Folder of the templates."""


def render_template(
    template: str, image_folder: Path, filters: dict[str, Callable[..., str]], **values: Any
) -> str:
    """Fill in the template of a study.

    Parameters
    ----------
    template : str
        Path below the folder of the studies, such as ``section3/report.html``.
    pictures : Path
        Folder of the PNG files that ``image(name)`` puts into the page.
    filters : dict of callables
        Besides Jinja's own.
    **values
        What the template names; a missing one is an error.
    """
    jinja2 = import_optional("jinja2", "report")
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(STUDIES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
    environment.filters.update(filters)

    def image(name: str) -> str:
        data = base64.b64encode((image_folder / name).read_bytes()).decode()
        return f"data:image/png;base64,{data}"

    html: str = environment.get_template(template).render(image=image, **values)
    return html
