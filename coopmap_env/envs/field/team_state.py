"""Where the robots of a team are: their maps, their bodies, and who knows whose pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry import Spheres, join_spheres
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots import Vehicle

Joints = NDArray[np.float64]
"""Joints of one mount, shape (n,), or of several poses, shape (k, n); radians or metres."""


@dataclass(frozen=True, eq=False)
class TeamState:
    """Vehicles of a team at given joints, and the maps that they plan on."""

    vehicles: tuple[Vehicle, ...]
    """Mounts and base poses: in the world frame, or in a robot's own frame until it is located."""
    joints: tuple[Joints, ...]
    """Encoder readings of each mount."""
    map: OccupancyMap
    """The team's map."""
    local_maps: tuple[OccupancyMap | None, ...]
    """Of each robot: the map in a frame of its own until it is located, then None."""

    @cached_property
    def located(self) -> tuple[bool, ...]:
        """Which robots know their pose in the common frame, that of the target."""
        return tuple(own is None for own in self.local_maps)

    def planning_map(self, robot: int) -> OccupancyMap:
        """The map that a robot plans on: the team's, or its own until it is located."""
        own = self.local_maps[robot]
        return self.map if own is None else own

    def located_teammates(self, robot: int) -> list[int]:
        """The other robots whose pose in the frame of a robot's map is known."""
        if not self.located[robot]:
            return []
        return [
            other for other, is_located in enumerate(self.located) if is_located and other != robot
        ]

    @cached_property
    def _vehicle_spheres(self) -> list[Spheres]:
        pairs = zip(self.vehicles, self.joints, strict=True)
        return [vehicle.spheres(q) for vehicle, q in pairs]

    def teammate_spheres(self, robot: int) -> list[Spheres]:
        """Spheres around each of a robot's located teammates."""
        return [self._vehicle_spheres[other] for other in self.located_teammates(robot)]

    def occluder_spheres(self, robot: int) -> Spheres:
        """Spheres around all of a robot's located teammates together."""
        return join_spheres(self.teammate_spheres(robot))

    def robot_spheres(self, robot: int, position_bounds: Sequence[float]) -> Spheres:
        """Spheres around a robot and its located teammates, each inflated by its position bound.

        No link deviates further than the camera, which is the farthest out.
        """
        inflated = []
        for other in sorted([robot, *self.located_teammates(robot)]):
            centers, radii = self._vehicle_spheres[other]
            inflated.append(Spheres(centers, radii + position_bounds[other]))
        return join_spheres(inflated)
