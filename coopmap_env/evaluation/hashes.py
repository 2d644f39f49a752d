"""SHA-256 of the files that decide the result of an episode."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Sequence
from pathlib import Path

from coopmap_env.simulation.scenes.field import read_user_scene


def file_hashes(policy: str, scene: str, env_name: str) -> dict[str, str]:
    """SHA-256 of the files that a policy's spec and a scene name, by path."""
    named = [Path(word) for word in re.split("[=+:]", policy) if word]
    return _sha256_of_files(named) | _scene_hashes(scene, env_name)


def _scene_hashes(scene: str, env_name: str) -> dict[str, str]:
    """SHA-256 of a planar scene's YAML and image files, or of a field scene's solids."""
    path = Path(scene)
    if path.suffix not in (".yaml", ".yml"):
        return {}
    if env_name == "planar":
        # the YAML file names its image, which is pgm or png
        return _sha256_of_files([path, *path.parent.glob("*.p[gn][mg]")])
    sha = hashlib.sha256(path.read_bytes())
    for solid in read_user_scene(path).solids:
        sha.update(solid.vertices.tobytes() + solid.faces.tobytes())
    return {scene: sha.hexdigest()}


def _sha256_of_files(paths: Sequence[Path]) -> dict[str, str]:
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()
    }
