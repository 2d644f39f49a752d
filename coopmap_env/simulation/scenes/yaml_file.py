"""Scene files in YAML: read once, with errors that name the file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coopmap_env.core.files import read_yaml_mapping
from coopmap_env.simulation.scenes.planar.recorded import SceneError


def read_yaml(path: Path) -> Mapping[str, Any]:
    """Read the fields of a scene's file.

    Raises
    ------
    SceneError
        With the file, if it cannot be read or holds no mapping.
    ImportError
        With the pip command, if PyYAML is not installed.
    """
    return read_yaml_mapping(path, SceneError)
