"""The one seam between the environment and the world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np


class MoveResult(NamedTuple):
    """How the motion of one robot ended."""

    measured_configuration: Any
    """Where the robot's own sensors say that it is now: a planar pose, or mount joints."""
    collided_with: str
    """What it bumped into and was stopped by; empty if nothing."""


class Simulator(Protocol):
    """Answers motions and looks; nothing else of the truth reaches a robot."""

    def move(self, targets: Sequence[Any], rng: np.random.Generator) -> Sequence[MoveResult]:
        """Move every robot to its target; `None` lets it stay. All noise comes from `rng`."""

    def scan(self, robot: int, rng: np.random.Generator) -> Any:
        """What the camera of a robot measures where it is; all noise comes from `rng`."""
