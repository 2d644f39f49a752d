"""Packages whose names are loaded on first use (PEP 562).

A package imports its names for type checkers and documentation only. `load_on_first_use` reads the
same lines, so that there is one list of where each name is from::

    if TYPE_CHECKING:
        from coopmap_env.mapping import OccupancyMap
    else:
        __getattr__ = load_on_first_use(__name__)

A name must not be that of a module of the same package: importing that module would take its place.
"""

from __future__ import annotations

import ast
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from typing import Any


def load_on_first_use(package: str) -> Callable[[str], Any]:
    """The `__getattr__` of a package: loads a name that it imports for type checkers."""

    @cache
    def homes() -> dict[str, tuple[str, str | None]]:
        return dict(typing_imports(_source(package)))

    def load(name: str) -> Any:
        if name not in homes():
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        home, original = homes()[name]
        module = import_module(home)
        value = module if original is None else getattr(module, original)
        setattr(sys.modules[package], name, value)  # asked for only once
        return value

    return load


def typing_imports(source: str) -> Iterator[tuple[str, tuple[str, str | None]]]:
    """Names that a module imports under ``if TYPE_CHECKING:``.

    Yields
    ------
    name : str
        In the module.
    home : tuple of str
        Module that it is from, and its name there; None if it is that module.
    """
    for node in ast.parse(source).body:
        if isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING":
            for line in node.body:
                if isinstance(line, ast.ImportFrom):
                    for alias in line.names:
                        yield alias.asname or alias.name, (line.module or "", alias.name)
                elif isinstance(line, ast.Import):
                    for alias in line.names:
                        yield alias.asname or alias.name, (alias.name, None)


def _source(package: str) -> str:
    spec = sys.modules[package].__spec__
    text: str | None = spec.loader.get_source(package)  # type: ignore[union-attr]
    if text is None:
        raise ImportError(f"{package} has no source, which names what it loads on first use")
    return text
