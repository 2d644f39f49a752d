"""From what a user calls a scene, by name, by file or as an object, to the scene."""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

from coopmap_env.core.files import FileError, brief

SceneT = TypeVar("SceneT")


class SceneError(FileError):
    """A file holds no usable scene; the message names file, field, value and what was expected."""


def make_scene(
    scene: Any,
    protocol: type[Any],
    by_name: Mapping[str, Callable[[], SceneT]],
    read_file: Callable[[str | os.PathLike[str]], SceneT],
) -> SceneT:
    """Make the scene of a name or of a YAML file; a scene is returned as it is.

    Parameters
    ----------
    scene : str, path or scene
        A key of `by_name`, the path of a file (.yaml or .yml), or a scene.
    protocol : type
        What a scene is an instance of.
    by_name : mapping of callables
        Each makes the scene of its name.
    read_file : callable
        Reads the scene of a path.

    Raises
    ------
    ValueError
        With the choices, if `scene` is none of these.
    SceneError
        If the file holds no usable scene.
    ImportError
        With the pip command, if an extra is missing.
    """
    if isinstance(scene, protocol) and not isinstance(scene, type):
        return cast(SceneT, scene)
    if isinstance(scene, str | os.PathLike):
        if isinstance(scene, str) and scene in by_name:
            return by_name[scene]()
        if Path(scene).suffix.lower() in (".yaml", ".yml"):
            return read_file(scene)
    names = ", ".join(repr(name) for name in by_name)
    raise ValueError(
        f"scene must be {names}, a path ending in .yaml or .yml, or a {protocol.__name__}, "
        f"not {brief(scene)}"
    )
