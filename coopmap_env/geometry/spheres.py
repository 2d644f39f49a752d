"""Spheres that cover bodies: robots and what they may collide with or hide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Spheres(NamedTuple):
    """Spheres in one frame."""

    centers: NDArray[np.float64]
    """Shape (s, 3), metres; of a robot at k poses (k, s, 3)."""
    radii: NDArray[np.float64]
    """Shape (s,), metres."""


NO_SPHERES = Spheres(np.zeros((0, 3)), np.zeros(0))


def join_spheres(parts: Sequence[Spheres]) -> Spheres:
    """All spheres of `parts`, in their order, as new arrays."""
    if not parts:
        return NO_SPHERES
    return Spheres(
        np.concatenate([part.centers for part in parts]),
        np.concatenate([part.radii for part in parts]),
    )
