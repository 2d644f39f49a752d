"""What the kernels of collision checking pass around."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.robots.collision.blocked_voxels import BlockedVoxels
from coopmap_env.robots.kinematics.collision_spheres import PartnerRanges
from coopmap_env.robots.kinematics.forward import BodyPoses, KinematicTree


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


class TeamSpheres(NamedTuple):
    """Spheres of the teammates, world frame."""

    centers: NDArray[np.float64]
    radii: NDArray[np.float64]
    margin: float
    """Metres between a sphere and a teammate's."""


class CollisionObstacles(NamedTuple):
    """What a robot may touch besides itself."""

    blocked: BlockedVoxels
    margin: float
    """Metres between a sphere and a blocked voxel."""
    team: TeamSpheres


@kernel
def name_robot(plain: PlainTuple) -> Robot:
    """The `Robot` of plain tuples."""
    tree, rotation, translation, spheres = plain
    body_index, centers, radii, n_static, partners, ranges, static_center, static_radius = spheres
    return Robot(
        KinematicTree(*tree),
        rotation,
        translation,
        RobotSpheres(
            body_index,
            centers,
            radii,
            n_static,
            partners,
            PartnerRanges(*ranges),
            static_center,
            static_radius,
        ),
    )


@kernel
def name_obstacles(plain: PlainTuple) -> CollisionObstacles:
    """The `CollisionObstacles` of plain tuples."""
    blocked, margin, team = plain
    return CollisionObstacles(BlockedVoxels(*blocked), margin, TeamSpheres(*team))


class Contact(NamedTuple):
    """What a robot touches."""

    kind: int
    """`NO_CONTACT`, `MAP_CONTACT`, `SELF_CONTACT` or `TEAM_CONTACT`."""
    sphere: int
    """Sphere of the robot."""
    other: int
    """Own sphere or teammate's sphere that it touches."""


class MotionContact(NamedTuple):
    """The first contact on a motion."""

    contact: Contact
    free_fraction: float
    """Fraction of the motion up to the last waypoint without contact."""
    at_goal: bool
    """Whether the contact is the goal's."""


class MotionBuffers(NamedTuple):
    """Scratch for one motion of a robot with s spheres."""

    poses: BodyPoses
    start: NDArray[np.float64]
    """Centers of the spheres at the start (s, 3), world frame; those of the contact's waypoint are
    in `at`, and of the goal in `goal`."""
    goal: NDArray[np.float64]
    at: NDArray[np.float64]
    next_end: NDArray[np.float64]
    """At the end of the present segment (s, 3)."""
    touching: NDArray[np.bool_]
    """Spheres that touch something at the start (s,)."""
    ignored: NDArray[np.bool_]
    """Spheres whose contacts do not count (yet) (s,)."""
    speeds: NDArray[np.float64]
    """Metres that each center may move from waypoint to waypoint (s,); 0 of those that no joint
    moves."""
    travel: NDArray[np.float64]
    """Metres that each center may move in a segment (s,)."""
    turns: NDArray[np.float64]
    """Radians or metres of the joint of each body in a segment (b,)."""
    axes: NDArray[np.float64]
    """World directions of the joints' axes (b, 3)."""
    q: NDArray[np.float64]
    """Joints of a waypoint (n,)."""
