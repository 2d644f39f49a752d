"""The surroundings of a target: where something may be placed, and what of it may stay."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.geometry import Pose
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._solid_queries import (
    distance_to_triangles,
    project_to_ground,
)
from coopmap_env.simulation.scenes.field.base_poses import (
    MIN_VISIBLE_FRACTION,
    first_hits_toward_target,
)
from coopmap_env.simulation.scenes.field.solid import Solid

_MAX_TRIES = 40
"""Positions that are drawn for a disc before it is given up."""
_DISC_GAP = 0.05
"""Metres between neighbouring discs."""


class SceneLayout:
    """What is placed around a target so far, each solid within a disc on the ground.

    Parameters
    ----------
    grid : VoxelGrid
        Discs lie inside.
    bases : sequence of Pose
        Discs keep `footprint` metres away from their axes.
    footprint : float
    target : sequence of Solid
        Discs do not overlap it. Solids that are added to it later count for `remove_occluders`
        only.
    """

    def __init__(
        self, grid: VoxelGrid, bases: Sequence[Pose], footprint: float, target: Sequence[Solid]
    ) -> None:
        self._low = np.array(grid.origin)[:2]
        self._high = self._low + np.array(grid.shape)[:2] * grid.resolution
        self._bases, self._footprint = bases, footprint
        self._target, self._target_triangles = target, project_to_ground(target)
        self._discs: list[tuple[NDArray[np.float64], float]] = []
        self.solids: list[Solid] = []
        self.support: list[int] = []
        """Index of the solid that each one stands on, -1 for the ground or the target."""

    def sample_free_disc(
        self, rng: np.random.Generator, radius: float, min_distance: float, max_distance: float
    ) -> NDArray[np.float64] | None:
        """Draw a free disc between two distances from the origin and reserve it.

        Returns
        -------
        (2,) float array or None
            Its center, or None if none was found.
        """
        for _ in range(_MAX_TRIES):
            distance = rng.uniform(min_distance, max_distance)
            angle = rng.uniform(-math.pi, math.pi)
            center = distance * np.array(sin_cos(angle)[::-1])
            if self.is_free(center, radius):
                self.reserve_disc(center, radius)
                return center
        return None

    def reserve_disc(self, center: NDArray[np.float64], radius: float) -> None:
        """Keep what is placed later off a disc."""
        self._discs.append((center, radius))

    def is_free(self, center: NDArray[np.float64], radius: float) -> bool:
        """Whether a disc lies inside the grid, clear of bases, reserved discs and the target."""
        return (
            bool((center - radius >= self._low).all() and (center + radius <= self._high).all())
            and all(
                math.dist(center, base.translation[:2]) >= self._footprint + radius
                for base in self._bases
            )
            and all(
                math.dist(center, other) >= radius + size + _DISC_GAP for other, size in self._discs
            )
            and distance_to_triangles(center[0], center[1], self._target_triangles)
            >= radius + _DISC_GAP
        )

    def add(self, solid: Solid, support: int = -1) -> int:
        """Place a solid on the one of index `support`, or on the ground; returns its index."""
        self.solids.append(solid)
        self.support.append(support)
        return len(self.solids) - 1

    def remove_occluders(self) -> list[Solid]:
        """The solids that may stay, without those that hide the target from a base.

        As long as too few rays from above a base reach the target, the solid that blocks most of
        them is removed, and with it what stands on it.
        """
        remaining = list(range(len(self.solids)))
        for base in self._bases:
            while remaining:
                scene = [*self._target, *(self.solids[k] for k in remaining)]
                hits = first_hits_toward_target(base.translation[:2], scene)
                blocked = hits[hits >= len(self._target)] - len(self._target)
                if len(blocked) <= (1.0 - MIN_VISIBLE_FRACTION) * len(hits):
                    break
                removed = {remaining[int(np.bincount(blocked).argmax())]}
                for k in remaining:  # what stands on a solid comes after it
                    if self.support[k] in removed:
                        removed.add(k)
                remaining = [k for k in remaining if k not in removed]
        return [self.solids[k] for k in remaining]
