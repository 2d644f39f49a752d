"""Typed access to the fields of a scene file."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from coopmap_env.core.files import brief
from coopmap_env.core.yaml_files import read_yaml_number
from coopmap_env.simulation.scenes.factory import SceneError

MAX_NUMBER = 1e6
"""Metres, degrees or a factor: what is larger is a broken number."""
MAX_TEXT = 1000
"""Letters."""


@dataclass(frozen=True)
class Fields:
    """Typed access to one mapping of the file, with errors that say where the entry is."""

    where: str
    content: Mapping[str, Any]

    def check_keys(self, *known: str) -> None:
        """Raise SceneError if there is another field than these."""
        unknown = [key for key in self.content if key not in known]
        if unknown:
            raise SceneError(
                f"{self.where}: unknown field {brief(unknown[0])}, expected {', '.join(known)}"
            )

    def error(self, field: str, expected: str) -> SceneError:
        """The error that a field is missing or not as expected."""
        if field not in self.content:
            return SceneError(f"{self.where}: {field} is missing, expected {expected}")
        return SceneError(
            f"{self.where}: {field} must be {expected}, not {brief(self.content[field])}"
        )

    def boolean(self, field: str, default: bool) -> bool:
        """Read true or false."""
        value = self.content.get(field, default)
        if not isinstance(value, bool):
            raise self.error(field, "true or false")
        return value

    def string(self, field: str, default: str | None = None) -> str:
        """Read text that is not empty."""
        value = self.content.get(field, default)
        if not isinstance(value, str) or not 0 < len(value) <= MAX_TEXT or "\0" in value:
            raise self.error(field, f"text of at most {MAX_TEXT} letters")
        return value

    def vector(self, field: str, default: float | None = None, above: float = -math.inf) -> Any:
        """Read three finite numbers above `above`, (3,)."""
        if field not in self.content and default is not None:
            return np.full(3, default)
        values = self.content.get(field)
        numbers = [read_yaml_number(value) for value in values] if isinstance(values, list) else []
        if len(numbers) != 3 or not all(map(math.isfinite, numbers)) or min(numbers) <= above:
            bound = "" if above == -math.inf else f" above {above:g}"
            raise self.error(field, f"three finite numbers{bound}")
        if max(map(abs, numbers)) > MAX_NUMBER:
            raise self.error(field, f"three numbers of at most {MAX_NUMBER:g}")
        return np.array(numbers)
