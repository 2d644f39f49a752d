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
from coopmap_env.robots.collision._arrays import (
    CollisionObstacles,
    FirstContacts,
    MapVoxels,
    Robot,
    RobotSpheres,
    TeamSpheres,
)
from coopmap_env.robots.collision._contact import (
    MAP_CONTACT,
    NO_CONTACT,
    SELF_CONTACT,
    are_poses_free,
    first_contacts,
)
from coopmap_env.robots.collision.voxel_states import STATE_NAMES, VoxelStates
from coopmap_env.robots.vehicle import Vehicle

_MIN_POSES_TO_DILATE = 100
"""Poses from which on it pays to dilate the mask first."""
_TYPICAL_WAYPOINTS = 20
"""Waypoints of a typical motion."""
_NO_NEIGHBORHOOD = np.empty((0, 0, 0), dtype=np.uint8)


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
        self.voxel_states = VoxelStates.from_map(map_, center, reach + largest_radius)
        self._teammate_index, centers, radii = _reachable_teammate_spheres(
            team, center, reach, self.settings
        )
        self._robot = robot_arrays(vehicle)
        self._largest_radius = largest_radius
        self._neighborhood: NDArray[np.uint8] | None = None
        self._team = TeamSpheres(centers, radii, float(self.settings.team_margin))

    def are_poses_free(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Whether poses (k, n) touch nothing, whatever the path."""
        q = np.atleast_2d(self.vehicle.chain.check_limits(q))
        out = np.empty(len(q), dtype=np.bool_)
        are_poses_free(self._robot, self._obstacles(len(q)), q, out)
        return out

    def are_motions_free(self, start: ArrayLike, goals: ArrayLike) -> NDArray[np.bool_]:
        """Whether goals (k, n) and the straight motions to them from `start` (n,) touch nothing."""
        free: NDArray[np.bool_] = self._first_contacts(start, goals, True).kind == NO_CONTACT
        return free

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
        found = self._first_contacts(start, goal, goal_first)
        kind, sphere, other = int(found.kind[0]), int(found.sphere[0]), int(found.other[0])
        if kind == NO_CONTACT:
            return None
        links, link = self.vehicle.chain.link_names, self.vehicle.body.link
        if kind == MAP_CONTACT:
            what = STATE_NAMES[other]
        elif kind == SELF_CONTACT:
            what = f"its own {links[link[other]]}"
        else:
            what = f"teammate {self._teammate_index[other]}"
        return PredictedContact(
            kind,
            links[link[sphere]],
            what,
            found.positions[0, sphere],
            float(found.free_fraction[0]),
            bool(found.at_goal[0]),
        )

    def infeasibility_reason(self, start: ArrayLike, goal: ArrayLike) -> str:
        """Why the mount cannot move straight from one pose to another; empty if it can."""
        contact = self.first_contact(start, goal, goal_first=True)
        return "" if contact is None else str(contact)

    def _obstacles(self, n_poses: int) -> CollisionObstacles:
        """Obstacles for kernels; the dilated mask pays for many poses only."""
        if self._neighborhood is None and n_poses >= _MIN_POSES_TO_DILATE:
            self._neighborhood = self.voxel_states.blocked_neighborhood(self._largest_radius)
        voxels = MapVoxels(
            self.voxel_states.states,
            _NO_NEIGHBORHOOD if self._neighborhood is None else self._neighborhood,
            self.voxel_states.lower,
            1.0 / self.voxel_states.resolution,
            float(self.settings.margin),
        )
        return CollisionObstacles(voxels, self._team)

    def _first_contacts(
        self, start: ArrayLike, goals: ArrayLike, goal_first: bool
    ) -> FirstContacts:
        chain = self.vehicle.chain
        q0, q1 = chain.as_joint_values(start), np.atleast_2d(chain.check_limits(goals))
        if q0.ndim != 1:
            raise ValueError(f"motions start from one pose, got joint values of shape {q0.shape}")
        n = len(q1)
        kind, sphere, other = np.empty((3, n), dtype=np.int64)
        found = FirstContacts(
            kind,
            sphere,
            other,
            np.empty(n),
            np.empty(n, dtype=np.bool_),
            np.empty((n, self.vehicle.body.n_spheres, 3)),
        )
        obstacles = self._obstacles(_TYPICAL_WAYPOINTS * n)
        first_contacts(self._robot, obstacles, q0, q1, float(self.settings.step), goal_first, found)
        return found


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
