"""Sphinx settings of the site: `make docs` builds it, and every warning is an error."""

import shutil
from importlib.metadata import version as installed_version
from pathlib import Path

from docutils import nodes
from sphinx.addnodes import pending_xref
from sphinx.application import Sphinx
from sphinx.environment import BuildEnvironment

project = "coopmap"
author = "The coopmap founders"
copyright = f"2026, {author}"
version = release = installed_version("coopmap")

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
]
exclude_patterns = ["leaderboard/*.json.gz"]
# Docstrings name code in single backticks: where it is documented, they become links.
default_role = "py:obj"
smartquotes = False  # many quotes are code
suppress_warnings = ["ref.python"]  # `shape` is an attribute of several classes: no link
myst_heading_anchors = 3
napoleon_google_docstring = False
napoleon_use_param = False  # types are prose, as in "shape (n, 3)": no links from their words
napoleon_use_rtype = False
templates_path = ["_templates"]
autosummary_imported_members = True  # packages list what users need in `__all__`
autosummary_ignore_module_all = False
# The side bar of each page would copy the names of all pages.
toc_object_entries = False
autodoc_member_order = "bysource"
autodoc_preserve_defaults = True
autodoc_mock_imports = ["benchmarl"]  # it needs another TorchRL than the rest
python_use_unqualified_type_names = True

html_theme = "furo"
html_title = f"coopmap {version}"
html_copy_source = False
# Nothing is loaded from elsewhere: the pages work without a network.
html_static_path = ["_static"]
html_css_files = ["site.css"]


def resolve_short_name(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, content: nodes.Element
) -> nodes.Element | None:
    """Docstrings say `PlanarSettings` or `PlanarSettings.v0`: find the one object that ends so."""
    if node.get("refdomain") != "py" or node.get("reftype") not in ("obj", "class"):
        return None
    python = env.domains.python_domain
    ends = f".{node['reftarget']}"
    found = [
        name for name, entry in python.objects.items() if name.endswith(ends) and not entry.aliased
    ]
    if len(found) != 1:
        return None
    node["reftarget"] = found[0]
    return python.resolve_xref(env, node["refdoc"], app.builder, "obj", found[0], node, content)


def copy_leaderboard(app: Sphinx, error: Exception | None) -> None:
    """The page of all submissions is an HTML file of its own, which links them."""
    if error is None:
        board = Path(app.outdir, "leaderboard")
        board.mkdir(exist_ok=True)
        for path in Path(app.srcdir, "leaderboard").iterdir():
            if path.suffix in (".html", ".gz"):
                shutil.copy(path, board)


def setup(app: Sphinx) -> None:
    """Connect the two functions above."""
    app.connect("missing-reference", resolve_short_name)
    app.connect("build-finished", copy_leaderboard)
