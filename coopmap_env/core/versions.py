"""Which versions made a record."""

from __future__ import annotations

import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

from coopmap_env.core.version import __version__


def versions(libraries: Iterable[str]) -> dict[str, str]:
    """Versions of coopmap, Python and those of some libraries that are installed."""
    found = {"coopmap": __version__, "python": platform.python_version()}
    for name in libraries:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
