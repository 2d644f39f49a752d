"""The interface between an environment and its true world."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

import numpy as np


class MoveResult(NamedTuple):
    """How the motion of one robot ended."""

    measured_configuration: Any
    """Where the robot's own sensors say that it is now: a planar pose, or mount joints."""
    collided_with: str
    """Name of the obstacle that stopped the robot; empty if there was none."""


class Simulator(Protocol):
    """Moves robots and scans; a robot learns nothing else of the true world."""

    def move(self, targets: Sequence[Any], rng: np.random.Generator) -> Sequence[MoveResult]:
        """Move every robot to its target; `None` lets it stay. All noise comes from `rng`."""

    def scan(self, robot: int, rng: np.random.Generator) -> Any:
        """What the camera of a robot measures at its current pose; all noise comes from `rng`."""
