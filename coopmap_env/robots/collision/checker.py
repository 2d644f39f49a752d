"""Which mount poses are free of collisions and reached by collision-free paths, in 3-D.

A motion is straight in the joints. The decision rests on what the robot knows: its map, its own
links and the poses of its teammates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots.collision import _motion
from coopmap_env.robots.collision._arrays import (
    CollisionObstacles,
    Robot,
    RobotSpheres,
    TeamSpheres,
)
from coopmap_env.robots.collision._contact import (
    MAP_CONTACT,
    NO_CONTACT,
    SELF_CONTACT,
    are_poses_free,
)
from coopmap_env.robots.collision.blocked_voxels import BlockedVoxels
from coopmap_env.robots.collision.voxel_states import STATE_NAMES, VoxelStates
from coopmap_env.robots.vehicle import Vehicle

_MIN_MOTIONS_FOR_DISTANCES = 4
"""Motions from which on it pays to find the distances to blocked voxels first."""


@dataclass(frozen=True)
class CollisionSettings(Settings):
    """Resolution of the collision check, and distances to obstacles.

    Raises
    ------
    ValueError
        If a value is out of its range.
    """

    step: Annotated[float, Bounds(above=0, smallest=0.001)] = 0.05
    """Metres: no sphere center moves farther between two checks; half a voxel."""
    margin: Annotated[float, Bounds(at_least=0, largest=10)] = 0.03
    """Metres between a link's spheres and a blocked voxel: half a step, so that nothing is missed
    between two checks, and a little for the body's motion on its suspension."""
    team_margin: Annotated[float, Bounds(at_least=0, largest=10)] = 0.1
    """Metres between own spheres and those of a teammate, whose body moves, too."""


@dataclass(frozen=True)
class PredictedContact:
    """The first contact on a motion."""

    kind: int
    """`MAP_CONTACT`, `SELF_CONTACT` or `TEAM_CONTACT`."""
    link: str
    other: str
    """Name of what would be touched."""
    position: NDArray[np.float64]
    """Shape (3,): of the link's sphere, world frame."""
    free_fraction: float
    """Fraction of the motion up to the last waypoint without contact."""
    at_goal: bool

    def __str__(self) -> str:
        where = ", ".join(f"{v:.2f}" for v in self.position)
        when = (
            "at the goal" if self.at_goal else f"after {100 * self.free_fraction:.0f} % of the path"
        )
        return f"link {self.link} would touch {self.other} at ({where}), {when}"


class CollisionChecker:
    """Decides which poses and motions of a mount are free, on what the robot knows at one time.

    It holds for the map as it is when the checker is made, and is of no use after a change of it.

    Parameters
    ----------
    vehicle : Vehicle
    map_ : OccupancyMap
        The known map, 3-D.
    team : sequence of (centers (s, 3), radii (s,)), optional
        Spheres of the teammates in the world frame, as of `Vehicle.spheres`.
    settings : CollisionSettings, optional
    """

    def __init__(
        self,
        vehicle: Vehicle,
        map_: OccupancyMap,
        team: Sequence[tuple[ArrayLike, ArrayLike]] = (),
        settings: CollisionSettings | None = None,
    ) -> None:
        self.vehicle = vehicle
        self.settings = settings or CollisionSettings()
        center, reach = vehicle.workspace_sphere
        largest_radius = float(vehicle.body.radii[vehicle.body.n_static_spheres :].max(initial=0.0))
        largest_radius += self.settings.margin
        self._map = map_
        self._has_distances = False
        self._teammate_index, centers, radii = _reachable_teammate_spheres(
            team, center, reach, self.settings
        )
        self._robot = robot_arrays(vehicle)
        self._obstacles = CollisionObstacles(
            BlockedVoxels.from_map(map_, center, reach + largest_radius),
            float(self.settings.margin),
            TeamSpheres(centers, radii, float(self.settings.team_margin)),
        )

    def are_poses_free(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Whether poses (k, n) touch nothing, whatever the path."""
        q = np.atleast_2d(self.vehicle.chain.check_limits(q))
        out = np.empty(len(q), dtype=np.bool_)
        are_poses_free(self._robot, self._obstacles, q, out)
        return out

    def are_motions_free(
        self, start: ArrayLike, goals: ArrayLike, n_wanted: int | None = None
    ) -> NDArray[np.bool_]:
        """Whether goals (k, n) and the straight motions to them from `start` (n,) touch nothing.

        With `n_wanted` the check ends once so many are free; goals after those count as not free.
        """
        q0, q1 = self._motion(start, goals)
        if not self._has_distances and len(q1) >= _MIN_MOTIONS_FOR_DISTANCES:
            self._obstacles.blocked.find_distances()
            self._has_distances = True
        out = np.empty(len(q1), dtype=np.bool_)
        n = len(q1) if n_wanted is None else n_wanted
        step = float(self.settings.step)
        _motion.are_motions_free(self._robot, self._obstacles, q0, q1, step, n, out)
        return out

    def first_contact(
        self, start: ArrayLike, goal: ArrayLike, goal_first: bool = False
    ) -> PredictedContact | None:
        """The first contact on the straight motion between joint values (n,); None if it is free.

        Spheres that touch something at the start already, which a new scan may reveal, may move
        away from there. With `goal_first` the goal is checked before the path, with a free fraction
        of 0.

        Raises
        ------
        ValueError
            If joint values have another shape, are not finite, or the goal is outside the limits.
        """
        q0, q1 = self._motion(start, goal)
        position = np.empty(3)
        (kind, sphere, other), free_fraction, at_goal = _motion.first_contact(
            self._robot, self._obstacles, q0, q1[0], float(self.settings.step), goal_first, position
        )
        if kind == NO_CONTACT:
            return None
        links, link = self.vehicle.chain.link_names, self.vehicle.body.link
        if kind == MAP_CONTACT:
            what = self._voxel_name(position, sphere)
        elif kind == SELF_CONTACT:
            what = f"its own {links[link[other]]}"
        else:
            what = f"teammate {self._teammate_index[other]}"
        return PredictedContact(kind, links[link[sphere]], what, position, free_fraction, at_goal)

    def infeasibility_reason(self, start: ArrayLike, goal: ArrayLike) -> str:
        """Why the mount cannot move straight from one pose to another; empty if it can."""
        contact = self.first_contact(start, goal, goal_first=True)
        return "" if contact is None else str(contact)

    def _voxel_name(self, position: NDArray[np.float64], sphere: int) -> str:
        """Name of what one of the spheres touches in the map."""
        radius = float(self.vehicle.body.radii[sphere]) + self.settings.margin
        box = VoxelStates.from_map(self._map, position, radius + self._map.grid.resolution)
        return STATE_NAMES[int(box.sphere_states(position, radius))]

    def _motion(
        self, start: ArrayLike, goals: ArrayLike
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Start (n,) and goals (k, n) of motions; the goals are inside the limits."""
        chain = self.vehicle.chain
        q0, q1 = chain.as_joint_values(start), np.atleast_2d(chain.check_limits(goals))
        if q0.ndim != 1:
            raise ValueError(f"motions start from one pose, got joint values of shape {q0.shape}")
        return q0, q1


def robot_arrays(vehicle: Vehicle) -> Robot:
    """A vehicle as kernels take it."""
    body, base = vehicle.body, vehicle.T_world_base
    spheres = RobotSpheres(
        body.sphere_body_index,
        body.local_centers,
        body.radii,
        body.n_static_spheres,
        body.partners,
        body.partner_ranges,
        base.transform(body.static_center)[None],
        body.static_radius,
    )
    rotation, translation = np.ascontiguousarray(base.rotation), base.translation
    return Robot(vehicle.chain.tree, rotation, np.ascontiguousarray(translation), spheres)


def _reachable_teammate_spheres(
    team: Sequence[tuple[ArrayLike, ArrayLike]],
    center: NDArray[np.float64],
    reach: float,
    settings: CollisionSettings,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Spheres of teammates that the mount can reach: teammate index, centers, radii."""
    index, centers, radii = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros(0)]
    for number, (at, wide) in enumerate(team):
        at, wide = np.asarray(at, dtype=np.float64), np.asarray(wide, dtype=np.float64)
        if at.ndim != 2 or at.shape[1] != 3 or wide.shape != (len(at),):
            raise ValueError(
                f"teammate {number} needs centers (s, 3) and radii (s,), got {at.shape} and "
                f"{wide.shape}"
            )
        near = np.linalg.norm(at - center, axis=1) < reach + wide + settings.team_margin
        index.append(np.full(np.count_nonzero(near), number))
        centers.append(at[near])
        radii.append(wide[near])
    return np.concatenate(index), np.concatenate(centers), np.concatenate(radii)
