"""SHA-256 of the files that decide the result of an episode."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from coopmap_env.core.files import read_bytes
from coopmap_env.core.yaml_files import read_yaml_mapping
from coopmap_env.robots import mount_files
from coopmap_env.simulation.scenes.field import read_user_scene


def file_hashes(
    policy: str, scene: str, env_name: str, mount: Mapping[str, Any] | None = None
) -> dict[str, str]:
    """SHA-256 of the files that a policy's spec, a scene and a mount's `MountFields` name, by path.

    Raises
    ------
    FileError
        If one of them is broken or too large.
    """
    named = re.split("[=+:]", policy)
    robot = [] if mount is None else map(str, mount_files(mount))
    return _sha256_of_files([*named, *robot]) | _scene_hashes(scene, env_name)


def _scene_hashes(scene: str, env_name: str) -> dict[str, str]:
    """SHA-256 of a planar scene's YAML and image file, or of a field scene's solids."""
    path = Path(scene)
    if path.suffix.lower() not in (".yaml", ".yml") or not os.path.isfile(path):
        return {}
    if env_name == "planar":
        image = read_yaml_mapping(path).get("image")
        return _sha256_of_files([scene, str(path.parent / image) if isinstance(image, str) else ""])
    sha = hashlib.sha256(read_bytes(path))
    for solid in read_user_scene(path).solids:
        sha.update(solid.vertices.tobytes() + solid.faces.tobytes())
    return {scene: sha.hexdigest()}


def _sha256_of_files(paths: Iterable[str]) -> dict[str, str]:
    """Hashes of those that are files; `isfile` is false for any text that is no path at all."""
    return {
        path: hashlib.sha256(read_bytes(path)).hexdigest() for path in paths if os.path.isfile(path)
    }
