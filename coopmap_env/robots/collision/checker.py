"""Which mount poses are reached safely: constraints i and ii of the paper, for articulated mounts.

A motion is straight in the joints. It is decided on what the robot knows: its map, its own links
and where its teammates are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.mapping import OccupancyMap
from coopmap_env.robots.collision.clearance import STATE_NAMES, VoxelStates
from coopmap_env.robots.collision.contact import (
    MAP_CONTACT,
    MAX_SEGMENT,
    NO_CONTACT,
    SELF_CONTACT,
    are_poses_free,
    first_contacts,
)
from coopmap_env.robots.vehicle import Vehicle

_MIN_POSES_TO_DILATE = 100
"""Poses for which marking the neighbourhoods of blocked voxels pays: 0.1 ms against 1 us each."""
_TYPICAL_WAYPOINTS = 20
"""Of a motion, more or less."""
_NO_NEIGHBORHOOD = np.empty((0, 0, 0), dtype=np.uint8)


@dataclass(frozen=True)
class CollisionSettings:
    """How closely a motion is looked at, and how far it keeps from what it might touch.

    Raises
    ------
    ValueError
        If a value is out of its range.
    """

    step: float = 0.05
    """Metres: no point of a link's middle moves farther between two checks; half a voxel."""
    margin: float = 0.03
    """Metres between a link's spheres and a blocked voxel: half a step, so that nothing slips
    through between two checks, and a little for the body's sway."""
    team_margin: float = 0.1
    """Metres between own spheres and those of a teammate, whose body sways too."""

    def __post_init__(self) -> None:
        for name in ("step", "margin", "team_margin"):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= 0) or (name == "step" and value == 0):
                raise ValueError(f"CollisionSettings.{name} must be finite and > 0, got {value}")


@dataclass(frozen=True)
class Contact:
    """Where a motion meets its first obstacle."""

    kind: int
    """`MAP_CONTACT`, `SELF_CONTACT` or `TEAM_CONTACT`."""
    link: str
    other: str
    """What would be touched, in words."""
    position: NDArray[np.float64]
    """Shape (3,): of the link's sphere, world frame."""
    free_fraction: float
    """Of the motion, up to the last waypoint without contact."""
    at_goal: bool

    def __str__(self) -> str:
        where = ", ".join(f"{v:.2f}" for v in self.position)
        when = (
            "at the goal" if self.at_goal else f"after {100 * self.free_fraction:.0f} % of the way"
        )
        return f"link {self.link} would touch {self.other} at ({where}), {when}"


class CollisionChecker:
    """What a vehicle knows at one time of all that its mount could touch.

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
        body, base = vehicle.body, vehicle.T_world_base
        self._tree = vehicle.chain.tree
        ball = np.append(
            base.transform(body.static_bounding_sphere[:3]), body.static_bounding_sphere[3]
        )[None]
        self._base = np.ascontiguousarray(base.rotation), np.ascontiguousarray(base.translation)
        self._spheres = (
            body.sphere_body_index, body.local_centers, body.radii, body.n_static_spheres,
            body.partner_ranges, body.partners, ball,
        )  # fmt: skip
        self._largest_radius = largest_radius
        self._neighborhood: NDArray[np.uint8] | None = None
        self._team = centers, radii, float(self.settings.team_margin)

    def are_poses_free(self, q: ArrayLike) -> NDArray[np.bool_]:
        """Whether poses (k, n) touch nothing: constraint i, without the way there."""
        q = np.atleast_2d(self.vehicle.chain.check_limits(q))
        out = np.empty(len(q), dtype=np.bool_)
        are_poses_free(
            self._tree, self._base, self._spheres, self._map_arguments(len(q)), self._team, q, out
        )
        return out

    def are_motions_free(self, start: ArrayLike, goals: ArrayLike) -> NDArray[np.bool_]:
        """Whether goals (k, n) touch nothing, nor do straight motions to them from `start` (n,)."""
        found, _ = self._first_contacts(start, goals, goal_first=True)
        free: NDArray[np.bool_] = found[:, 0] == NO_CONTACT
        return free

    def first_contact(
        self, start: ArrayLike, goal: ArrayLike, goal_first: bool = False
    ) -> Contact | None:
        """The first contact on the straight motion between joint values (n,); None if it is free.

        What touches at the start already, by new knowledge, may move away from there. With
        `goal_first` the goal is asked about before the way there, with a free share of 0.

        Raises
        ------
        ValueError
            If joint values have another shape, are not finite, or the goal is outside the limits.
        """
        found, at = self._first_contacts(start, goal, goal_first)
        kind, sphere, other = found[0, :3].astype(np.int64)
        if kind == NO_CONTACT:
            return None
        links, link = self.vehicle.chain.link_names, self.vehicle.body.link
        if kind == MAP_CONTACT:
            what = STATE_NAMES[other]
        elif kind == SELF_CONTACT:
            what = f"its own {links[link[other]]}"
        else:
            what = f"teammate {self._teammate_index[other]}"
        fraction, at_goal = float(found[0, 3]), bool(found[0, 4])
        return Contact(int(kind), links[link[sphere]], what, at[0, sphere], fraction, at_goal)

    def infeasibility_reason(self, start: ArrayLike, goal: ArrayLike) -> str:
        """Why the mount cannot move straight from one pose to another; empty if it can."""
        contact = self.first_contact(start, goal, goal_first=True)
        return "" if contact is None else str(contact)

    def _map_arguments(self, n_poses: int) -> tuple[Any, ...]:
        """The map as kernels want it; what is near to blocked voxels pays for many poses only."""
        if self._neighborhood is None and n_poses >= _MIN_POSES_TO_DILATE:
            self._neighborhood = self.voxel_states.blocked_neighborhood(self._largest_radius)
        return (
            self.voxel_states.states, _NO_NEIGHBORHOOD if self._neighborhood is None else self._neighborhood,
            self.voxel_states.lower, 1.0 / self.voxel_states.resolution, float(self.settings.margin),
        )  # fmt: skip

    def _first_contacts(
        self, start: ArrayLike, goals: ArrayLike, goal_first: bool
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """What the kernel `first_contacts` finds on each motion, and where the spheres are then."""
        chain = self.vehicle.chain
        q0, q1 = chain.as_joint_values(start), np.atleast_2d(chain.check_limits(goals))
        if q0.ndim != 1:
            raise ValueError(f"motions start from one pose, got joint values of shape {q0.shape}")
        pieces = int(np.abs(q1 - q0).max(initial=0.0) / MAX_SEGMENT) + 1
        found, at = np.empty((len(q1), 5)), np.empty((len(q1), self.vehicle.body.n_spheres, 3))
        first_contacts(
            self._tree, self._base, self._spheres, self._map_arguments(_TYPICAL_WAYPOINTS * len(q1)), self._team,
            q0, q1, self.settings.step, goal_first, np.empty(pieces, dtype=np.int64), found, at,
        )  # fmt: skip
        return found, at


def _reachable_teammate_spheres(
    team: Sequence[tuple[ArrayLike, ArrayLike]],
    center: NDArray[np.float64],
    reach: float,
    settings: CollisionSettings,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
    """Spheres of teammates that the mount could touch: whose, centres, radii."""
    whose, centers, radii = [np.zeros(0, np.int64)], [np.zeros((0, 3))], [np.zeros(0)]
    for number, (at, wide) in enumerate(team):
        at, wide = np.asarray(at, dtype=np.float64), np.asarray(wide, dtype=np.float64)
        if at.ndim != 2 or at.shape[1] != 3 or wide.shape != (len(at),):
            raise ValueError(
                f"teammate {number} needs centres (s, 3) and radii (s,), got {at.shape} and "
                f"{wide.shape}"
            )
        near = np.linalg.norm(at - center, axis=1) < reach + wide + settings.team_margin
        whose.append(np.full(np.count_nonzero(near), number))
        centers.append(at[near])
        radii.append(wide[near])
    return np.concatenate(whose), np.concatenate(centers), np.concatenate(radii)
