"""The yard around a target: spots for what surrounds it, and what of it may stay."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.simulation.scenes.field.base_poses import SIGHT, looks_at_target
from coopmap_env.simulation.scenes.field.outlines import distance_to_outlines, outlines
from coopmap_env.simulation.scenes.field.solid import Solid

_TRIES = 40
_GAP = 0.05
"""Metres between the circles around neighbours."""


class Yard:
    """What stands around the target so far, each thing within a circle on the ground.

    Parameters
    ----------
    grid : VoxelGrid
        Circles lie inside.
    bases : sequence of Pose
        Circles keep `footprint` metres away from their axes.
    target : sequence of Solid
        Circles do not meet it.
    """

    def __init__(
        self, grid: VoxelGrid, bases: Sequence[Pose], footprint: float, target: Sequence[Solid]
    ) -> None:
        self._low = np.array(grid.origin)[:2]
        self._high = self._low + np.array(grid.shape)[:2] * grid.resolution
        self._bases, self._footprint = bases, footprint
        self._target, self._outlines = target, outlines(target)
        self._circles: list[tuple[NDArray[np.float64], float]] = []
        self.solids: list[Solid] = []
        self.below: list[int] = []
        """Index of the solid that each one stands on, -1 for the ground or the target."""

    def spot(
        self, rng: np.random.Generator, radius: float, nearest: float, farthest: float
    ) -> NDArray[np.float64] | None:
        """Draw a free circle between two distances from the origin and take it.

        Returns
        -------
        (2,) float array or None
            Its middle, or None if none was found.
        """
        for _ in range(_TRIES):
            distance, angle = rng.uniform(nearest, farthest), rng.uniform(-math.pi, math.pi)
            middle = distance * np.array([math.cos(angle), math.sin(angle)])
            if self.is_free(middle, radius):
                self._circles.append((middle, radius))
                return middle
        return None

    def is_free(self, middle: NDArray[np.float64], radius: float) -> bool:
        """Whether a circle lies inside the grid and meets nothing that has its place."""
        return (
            bool((middle - radius >= self._low).all() and (middle + radius <= self._high).all())
            and all(
                math.dist(middle, base.translation[:2]) >= self._footprint + radius
                for base in self._bases
            )
            and all(
                math.dist(middle, other) >= radius + size + _GAP for other, size in self._circles
            )
            and distance_to_outlines(middle[0], middle[1], self._outlines) >= radius + _GAP
        )

    def add(self, solid: Solid, below: int = -1) -> int:
        """Put a solid down; returns its index."""
        self.solids.append(solid)
        self.below.append(below)
        return len(self.solids) - 1

    def in_sight(self) -> list[Solid]:
        """Take away what hides the target from a base; return the solids that stay.

        As long as less than a quarter of a base's looks get through to the target, the solid that
        stops most of them goes, and with it what stands on it.
        """
        staying = list(range(len(self.solids)))
        for base in self._bases:
            while staying:
                standing = [*self._target, *(self.solids[k] for k in staying)]
                met = looks_at_target(base.translation[:2], standing)
                stopped = met[met >= len(self._target)] - len(self._target)
                if len(stopped) <= (1.0 - SIGHT) * len(met):
                    break
                gone = {staying[int(np.bincount(stopped).argmax())]}
                for k in staying:  # what stands on a solid comes after it
                    if self.below[k] in gone:
                        gone.add(k)
                staying = [k for k in staying if k not in gone]
        return [self.solids[k] for k in staying]
