"""The one seam between the environment and the world."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from coopmap_env.sensing import Scan


class Simulator(Protocol):
    """Answers looks and motions; nothing else of the truth reaches a robot."""

    def scan(self, pose: ArrayLike, rng: np.random.Generator) -> Scan:
        """What a camera at `pose` measures, all noise drawn from `rng`."""

    def collides(self, pose: Sequence[float]) -> bool:
        """Whether a camera cannot stand at `pose`, whatever the map says."""
