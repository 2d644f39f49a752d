"""What the kernels of collision checking pass around."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.robots.kinematics.collision_spheres import PartnerRanges
from coopmap_env.robots.kinematics.forward import KinematicTree


class RobotSpheres(NamedTuple):
    """`CollisionSpheres` as kernels take them."""

    body_index: NDArray[np.int64]
    local_centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    n_static: int
    """Spheres that no joint moves; they come first."""
    partners: NDArray[np.int64]
    partner_ranges: PartnerRanges
    static_center: NDArray[np.float64]
    """Shape (1, 3): center of a sphere around all static ones, world frame."""
    static_radius: float


class Robot(NamedTuple):
    """A mount with its base in the world, and the spheres that cover it."""

    tree: KinematicTree
    base_rotation: NDArray[np.float64]
    base_translation: NDArray[np.float64]
    spheres: RobotSpheres


class MapVoxels(NamedTuple):
    """`VoxelStates` as kernels take them."""

    states: NDArray[np.uint8]
    neighborhood: NDArray[np.uint8]
    """See `VoxelStates.blocked_neighborhood`; empty if it was not computed."""
    lower: NDArray[np.float64]
    """Lower corner (3,), metres, world frame."""
    scale: float
    """Voxels per metre."""
    margin: float
    """Metres between a sphere and a blocked voxel."""


class TeamSpheres(NamedTuple):
    """Spheres of the teammates, world frame."""

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    margin: float
    """Metres between a sphere and a teammate's."""


class CollisionObstacles(NamedTuple):
    """What a robot may touch besides itself."""

    voxels: MapVoxels
    team: TeamSpheres


class FirstContacts(NamedTuple):
    """The first contact on each of k motions."""

    kind: NDArray[np.int64]
    """`NO_CONTACT`, `MAP_CONTACT`, `SELF_CONTACT` or `TEAM_CONTACT` (k,)."""
    sphere: NDArray[np.int64]
    """Sphere of the robot (k,)."""
    other: NDArray[np.int64]
    """Voxel state, own sphere or teammate's sphere that it touches (k,)."""
    free_fraction: NDArray[np.float64]
    """Fraction of the motion up to the last waypoint without contact (k,)."""
    at_goal: NDArray[np.bool_]
    """Whether the contact is the goal's (k,)."""
    positions: NDArray[np.float64]
    """Centers of all spheres at the contact (k, s, 3)."""
