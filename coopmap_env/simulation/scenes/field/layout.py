"""The yard around a target: spots for what surrounds it, and what of it may stay."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.mapping.grid import VoxelGrid
from coopmap_env.simulation.scenes.field.base_poses import (
    MIN_VISIBLE_FRACTION,
    first_hits_toward_target,
)
from coopmap_env.simulation.scenes.field.outlines import distance_to_triangles, project_to_ground
from coopmap_env.simulation.scenes.field.solid import Solid

_MAX_TRIES = 40
_DISC_GAP = 0.05
"""Metres between the circles around neighbours."""


class SceneLayout:
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
        self._target, self._target_triangles = target, project_to_ground(target)
        self._circles: list[tuple[NDArray[np.float64], float]] = []
        self.solids: list[Solid] = []
        self.support: list[int] = []
        """Index of the solid that each one stands on, -1 for the ground or the target."""

    def sample_free_disc(
        self, rng: np.random.Generator, radius: float, min_distance: float, max_distance: float
    ) -> NDArray[np.float64] | None:
        """Draw a free circle between two distances from the origin and take it.

        Returns
        -------
        (2,) float array or None
            Its middle, or None if none was found.
        """
        for _ in range(_MAX_TRIES):
            distance, angle = (
                rng.uniform(min_distance, max_distance),
                rng.uniform(-math.pi, math.pi),
            )
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
                math.dist(middle, other) >= radius + size + _DISC_GAP
                for other, size in self._circles
            )
            and distance_to_triangles(middle[0], middle[1], self._target_triangles)
            >= radius + _DISC_GAP
        )

    def add(self, solid: Solid, support: int = -1) -> int:
        """Put a solid down; returns its index."""
        self.solids.append(solid)
        self.support.append(support)
        return len(self.solids) - 1

    def remove_occluders(self) -> list[Solid]:
        """Take away what hides the target from a base; return the solids that stay.

        As long as less than a quarter of a base's looks get through to the target, the solid that
        stops most of them goes, and with it what stands on it.
        """
        remaining = list(range(len(self.solids)))
        for base in self._bases:
            while remaining:
                occluders = [*self._target, *(self.solids[k] for k in remaining)]
                hits = first_hits_toward_target(base.translation[:2], occluders)
                blocked = hits[hits >= len(self._target)] - len(self._target)
                if len(blocked) <= (1.0 - MIN_VISIBLE_FRACTION) * len(hits):
                    break
                removed = {remaining[int(np.bincount(blocked).argmax())]}
                for k in remaining:  # what stands on a solid comes after it
                    if self.support[k] in removed:
                        removed.add(k)
                remaining = [k for k in remaining if k not in removed]
        return [self.solids[k] for k in remaining]
