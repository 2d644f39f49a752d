"""Scenes on the command lines of studies."""

from __future__ import annotations

import json
from typing import Any


def parse_scene(text: str) -> str | dict[str, Any]:
    """A scene by its name, or the JSON object of a name and fields; see `EnvSpec.make`."""
    scene: str | dict[str, Any] = json.loads(text) if text.startswith("{") else text
    return scene
