"""Optional dependencies: imported where they are used, named when they are missing."""

import importlib
from types import ModuleType


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
            f"{module} is needed here and is not installed: pip install 'coopmap[{extra}]'"
        ) from error
