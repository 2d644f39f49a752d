"""Which mount poses are free of collisions and reached by collision-free paths, in 3-D.

A motion is straight in the joints. The decision rests on what the robot knows: its map, its own
links and the poses of its teammates.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple, kernel, make_plain
from coopmap_env.core.settings import Bounds, Settings
from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots.collision import _motion
from coopmap_env.robots.collision._arrays import Robot, RobotSpheres
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
        self._map = map_
        self._has_distances = False
        margin, team_margin = float(self.settings.margin), float(self.settings.team_margin)
        mount = _reaching_mount(vehicle)
        self._robot = mount.robot
        self._blocked = BlockedVoxels.from_map(
            map_, mount.center, mount.reach + (mount.largest_radius + margin)
        )
        self._teammate_index, centers, radii = _reachable_teammate_spheres(
            team, mount.center, mount.reach, team_margin
        )
        self._obstacles = (tuple(self._blocked), margin, (centers, radii, team_margin))

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
            self._blocked.find_distances()
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


class _ReachingMount(NamedTuple):
    """What all checkers of a vehicle have in common."""

    robot: PlainTuple
    """A plain `Robot`."""
    center: tuple[float, float, float]
    """Of `Vehicle.workspace_sphere`."""
    reach: float
    largest_radius: float
    """Metres, of the spheres that a joint moves."""


_MOUNTS: WeakKeyDictionary[Vehicle, _ReachingMount] = WeakKeyDictionary()


def _reaching_mount(vehicle: Vehicle) -> _ReachingMount:
    """Made once for each vehicle, which is checked at every step."""
    found = _MOUNTS.get(vehicle)
    if found is None:
        robot, (center, reach) = robot_arrays(vehicle), vehicle.workspace_sphere
        moving = robot.spheres.radii[robot.spheres.n_static :]
        x, y, z = center.tolist()
        found = _MOUNTS[vehicle] = _ReachingMount(
            make_plain(robot), (x, y, z), reach, float(moving.max(initial=0.0))
        )
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
    center: tuple[float, float, float],
    reach: float,
    margin: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Spheres of teammates that the mount can reach: teammate index, centers, radii."""
    spheres = [
        (np.ascontiguousarray(at, dtype=np.float64), np.ascontiguousarray(wide, dtype=np.float64))
        for at, wide in team
    ]
    n = sum(wide.size for _, wide in spheres)
    index, centers, radii = np.empty(n, dtype=np.int64), np.empty((n, 3)), np.empty(n)
    count = 0
    for number, (at, wide) in enumerate(spheres):
        if at.ndim != 2 or at.shape[1] != 3 or wide.shape != (len(at),):
            raise ValueError(
                f"teammate {number} needs centers (s, 3) and radii (s,), got {at.shape} and "
                f"{wide.shape}"
            )
        before = count
        count += _copy_reachable(at, wide, center, reach, margin, centers[count:], radii[count:])
        index[before:count] = number
    return index[:count], centers[:count], radii[:count]


@kernel
def _copy_reachable(
    at: NDArray[np.float64],
    wide: NDArray[np.float64],
    center: tuple[float, float, float],
    reach: float,
    margin: float,
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> int:
    """Copy the spheres (s, 3), (s,) that come within `reach` + `margin` of a point; how many."""
    count = 0
    for s in range(len(at)):
        dx, dy, dz = at[s, 0] - center[0], at[s, 1] - center[1], at[s, 2] - center[2]
        if math.sqrt(dx * dx + dy * dy + dz * dz) < reach + wide[s] + margin:
            centers[count, 0], centers[count, 1], centers[count, 2] = at[s, 0], at[s, 1], at[s, 2]
            radii[count] = wide[s]
            count += 1
    return count
