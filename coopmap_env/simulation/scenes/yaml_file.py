"""Scene files in YAML: read once, with errors that name the file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from coopmap_env.core.extras import import_optional
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
    yaml = import_optional("yaml", "maps")
    try:
        content = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(f"{path}: cannot be read: {error}") from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # ValueError: no such date
        raise SceneError(f"{path}: expected YAML: {error}") from error
    if not isinstance(content, Mapping):
        raise SceneError(f"{path}: expected a YAML mapping of fields, not {content!r:.80}")
    return content
