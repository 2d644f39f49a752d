"""Optional dependencies: imported where they are used, named when they are missing."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, distribution
from importlib.util import find_spec
from types import ModuleType

EXTRAS: dict[str, tuple[str, ...]] = {
    "maps": ("yaml", "PIL"),
    "render": ("PIL", "pygame"),
    "report": ("matplotlib", "jinja2"),
    "data": ("rtbdata", "skimage"),
    "field": ("pybullet", "trimesh", "embreex"),
    "mounts": ("example_robot_data",),
    "paths": ("ompl",),
    "octomap": ("pyoctomap",),
    "replay": ("viser",),
    "record": ("h5py",),
    "rl": ("torch", "safetensors"),
    "onnx": ("onnxruntime",),
    "ray": ("ray",),
    "benchmarl": ("benchmarl",),
    "bench": ("mpe2", "psutil"),
    "tuning": ("optuna",),
}
"""Modules that everything needs that needs an extra; ``pyproject.toml`` has the distributions."""
WITHOUT_WHEELS = {"pybullet": (3, 12)}
"""Modules that have no wheels from a version of Python on, which no pip command changes."""


def import_optional(module: str, extra: str) -> ModuleType:
    """Import an optional module, or raise an error with the pip command that installs it.

    Parameters
    ----------
    module : str
        Name to import, such as ``"PIL.Image"``.
    extra : str
        The extra of this distribution that installs it.

    Raises
    ------
    ImportError
        With the pip command, if the module is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(
            f"{module} is needed here and is not installed: {_remedy([module], [extra])}"
        ) from error


def missing_extras(extras: Iterable[str]) -> dict[str, list[str]]:
    """Extras of which a module is not installed, with those modules; nothing is imported."""
    missing = {
        extra: [module for module in EXTRAS[extra] if not _is_installed(module)]
        for extra in dict.fromkeys(extras)
    }
    return {extra: modules for extra, modules in missing.items() if modules}


def require_extras(extras: Iterable[str]) -> None:
    """Check that extras are installed, before long work begins.

    Raises
    ------
    ImportError
        With all that are missing and one pip command.
    """
    if missing := missing_extras(extras):
        modules = [module for modules in missing.values() for module in modules]
        verb = "is" if len(modules) == 1 else "are"
        raise ImportError(
            f"{', '.join(modules)} {verb} needed here and {verb} not installed: "
            f"{_remedy(modules, missing)}"
        )


def pip_command(extras: Iterable[str]) -> str:
    """Command that installs extras."""
    return f"pip install 'coopmap[{','.join(extras)}]'"


def _remedy(modules: Iterable[str], extras: Iterable[str]) -> str:
    """The pip command, and what it cannot install for this version of Python."""
    notes = [
        f" ({module} has no wheels from Python {major}.{minor} on: use an earlier one for it)"
        for module in modules
        if module in WITHOUT_WHEELS and sys.version_info >= WITHOUT_WHEELS[module]
        for major, minor in [WITHOUT_WHEELS[module]]
    ]
    return "".join([pip_command(extras), *notes])


def _is_installed(module: str) -> bool:
    try:
        if find_spec(module) is not None:
            return True
    except (ModuleNotFoundError, ValueError):  # hidden, or in the place of a module without a spec
        return False
    try:
        distribution(module)  # one of files without a module, as example-robot-data
    except PackageNotFoundError:
        return False
    return True
