"""Kernels: which parts of a mount's motion could touch anything, by spheres and boxes.

Links are covered by spheres. At a few configurations along the motion, their gaps to the boxes
around all solids, to the spheres of other vehicles and to the boxes of the own body are compared
with how far each sphere moves in between. Only where a gap is too small does the physics engine
check. The test errs on one side only: a segment that is not marked touches nothing.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.geometry import RigidTransform, Spheres
from coopmap_env.robots import BodyPoses, KinematicTree, allocate_body_poses, body_poses

ARC_FACTOR = 0.55
"""Fraction of the chord between two configurations: no point of the arc is further from both its
ends, for arcs of less than a quarter turn; half the chord would be that of a straight line."""
CONTACT_MARGIN = 0.005
"""Metres: more than the margins that the physics engine puts around its shapes."""


class SweepObstacles(NamedTuple):
    """What a mount may collide with, but for its own body."""

    boxes: NDArray[np.float64]
    """Shape (b, 2, 3): lower and upper corners, world frame."""
    spheres: Spheres


class LinkSpheres(NamedTuple):
    """Spheres that are fixed to rigid bodies."""

    bodies: NDArray[np.int64]
    """Shape (s,): the rigid body of each."""
    offsets: NDArray[np.float64]
    """Shape (s, 3): their centers in the frames of their bodies."""
    radii: NDArray[np.float64]
    """Shape (s,)."""


class OwnBoxes(NamedTuple):
    """Boxes around the links of the vehicle's body, which carries the mount."""

    boxes: NDArray[np.float64]
    """Shape (o, 2, 3): lower and upper corners, in the frames of rigid bodies."""
    bodies: NDArray[np.int64]
    """Shape (o,): the rigid body of each."""
    checked_pairs: NDArray[np.bool_]
    """Shape (s, o): boxes with which each sphere of the mount can collide; not adjacent links."""


@borrowing_kernel
def squared_distance_to_box(
    x: float, y: float, z: float, lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> float:
    """Squared distance from a point to a box; 0 within."""
    dx = max(lower[0] - x, 0.0, x - upper[0])
    dy = max(lower[1] - y, 0.0, y - upper[1])
    dz = max(lower[2] - z, 0.0, z - upper[2])
    return dx * dx + dy * dy + dz * dz


@kernel
def sphere_centers(
    tree: KinematicTree,
    T_world_base: RigidTransform,
    q: NDArray[np.float64],
    spheres: LinkSpheres,
    work: BodyPoses,
    out: NDArray[np.float64],
) -> None:
    """Write the centers (s, 3) of spheres at one q, world frame; `work` is overwritten."""
    R, t = work[0], work[1]
    R[0] = T_world_base.rotation
    t[0] = T_world_base.translation
    body_poses(tree, q, work)
    for s in range(len(spheres.bodies)):
        b = spheres.bodies[s]
        x, y, z = spheres.offsets[s, 0], spheres.offsets[s, 1], spheres.offsets[s, 2]
        for i in range(3):
            out[s, i] = t[b, i] + R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z


@borrowing_kernel
def squared_distance_to_own_body(
    center: NDArray[np.float64],
    sphere: int,
    own: OwnBoxes,
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> float:
    """Squared distance from the center (3,) of a sphere to the nearest box that it can touch.

    `R` (b, 3, 3), `t` (b, 3) are the poses of all rigid bodies.
    """
    best = math.inf
    for o in range(len(own.boxes)):
        if own.checked_pairs[sphere, o]:
            b = own.bodies[o]
            dx, dy, dz = center[0] - t[b, 0], center[1] - t[b, 1], center[2] - t[b, 2]
            px = R[b, 0, 0] * dx + R[b, 1, 0] * dy + R[b, 2, 0] * dz
            py = R[b, 0, 1] * dx + R[b, 1, 1] * dy + R[b, 2, 1] * dz
            pz = R[b, 0, 2] * dx + R[b, 1, 2] * dy + R[b, 2, 2] * dz
            distance = squared_distance_to_box(px, py, pz, own.boxes[o, 0], own.boxes[o, 1])
            best = min(best, distance)
    return best


@borrowing_kernel
def path_length(centers: NDArray[np.float64], k: int, s: int) -> float:
    """How far a sphere goes in a segment, in a straight line; `centers` (k, n, 3) are of all."""
    x = centers[k + 1, s, 0] - centers[k, s, 0]
    y = centers[k + 1, s, 1] - centers[k, s, 1]
    z = centers[k + 1, s, 2] - centers[k, s, 2]
    return math.sqrt(x * x + y * y + z * z)


@borrowing_kernel
def measure_gaps(
    centers: NDArray[np.float64],
    s: int,
    radius: float,
    obstacles: SweepObstacles,
    bounds: NDArray[np.float64],
    gaps: NDArray[np.float64],
) -> None:
    """Lower the gaps (k, s) of one sphere to what is near to its whole path.

    `centers` (k, n, 3) are those of all spheres; `bounds` (2, 3) is overwritten. The gaps hold
    squared distances to the own body and become distances to the nearest of all.
    """
    n = len(centers)
    boxes, spheres = obstacles
    lower, upper = bounds[0], bounds[1]
    reach = 0.0
    for k in range(n - 1):
        reach = max(reach, path_length(centers, k, s))
    reach = ARC_FACTOR * reach + radius + CONTACT_MARGIN
    for i in range(3):
        lowest = highest = centers[0, s, i]
        for k in range(1, n):
            lowest, highest = min(lowest, centers[k, s, i]), max(highest, centers[k, s, i])
        lower[i], upper[i] = lowest - reach, highest + reach
    for b in range(len(boxes)):
        overlaps = True
        for i in range(3):
            overlaps &= boxes[b, 0, i] < upper[i] and boxes[b, 1, i] > lower[i]
        if overlaps:
            for k in range(n):
                x, y, z = centers[k, s, 0], centers[k, s, 1], centers[k, s, 2]
                d = squared_distance_to_box(x, y, z, boxes[b, 0], boxes[b, 1])
                gaps[k, s] = min(gaps[k, s], d)
    for k in range(n):
        gaps[k, s] = math.sqrt(gaps[k, s])
    for o in range(len(spheres.radii)):
        x, y, z = spheres.centers[o, 0], spheres.centers[o, 1], spheres.centers[o, 2]
        r = spheres.radii[o]
        if squared_distance_to_box(x, y, z, lower, upper) < r * r:
            for k in range(n):
                dx, dy, dz = centers[k, s, 0] - x, centers[k, s, 1] - y, centers[k, s, 2] - z
                gaps[k, s] = min(gaps[k, s], math.sqrt(dx * dx + dy * dy + dz * dz) - r)


@kernel
def write_sphere_centers(
    plain_tree: PlainTuple,
    base_pose: PlainTuple,
    q: NDArray[np.float64],
    plain_spheres: PlainTuple,
    out: NDArray[np.float64],
) -> None:
    """Write the centers (s, 3) of spheres at one q, world frame.

    A plain `KinematicTree`, `RigidTransform` and `LinkSpheres`.
    """
    tree, spheres = KinematicTree(*plain_tree), LinkSpheres(*plain_spheres)
    sphere_centers(tree, RigidTransform(*base_pose), q, spheres, allocate_body_poses(tree), out)


@kernel
def mark_swept_collisions(
    model: PlainTuple,
    base_pose: PlainTuple,
    q: NDArray[np.float64],
    boxes: NDArray[np.float64],
    plain_spheres: PlainTuple,
    may_collide: NDArray[np.bool_],
    travel: NDArray[np.float64],
) -> None:
    """Mark the segments (k - 1,) between configurations q (k, m) in which something may touch.

    `model` is that of `SweepModel.plain`, `base_pose` a plain `RigidTransform`; `boxes` (b, 2, 3)
    and the plain `Spheres` are the obstacles. `travel` (k - 1,) receives how far the fastest
    sphere goes, in a straight line.
    """
    tree, arm, own = KinematicTree(*model[0]), LinkSpheres(*model[1]), OwnBoxes(*model[2])
    T_world_base, obstacles = (
        RigidTransform(*base_pose),
        SweepObstacles(boxes, Spheres(*plain_spheres)),
    )
    n, n_spheres = len(q), len(arm.bodies)
    work = allocate_body_poses(tree)
    centers = np.empty((n, n_spheres, 3))
    gaps, bounds = np.empty((n, n_spheres)), np.empty((2, 3))
    for k in range(n):
        sphere_centers(tree, T_world_base, q[k], arm, work, centers[k])
        for s in range(n_spheres):
            gaps[k, s] = squared_distance_to_own_body(centers[k, s], s, own, work[0], work[1])
    for s in range(n_spheres):
        measure_gaps(centers, s, arm.radii[s], obstacles, bounds, gaps)
    for k in range(n - 1):
        may_collide[k] = False
        travel[k] = 0.0
        for s in range(n_spheres):
            chord = path_length(centers, k, s)
            travel[k] = max(travel[k], chord)
            needed = ARC_FACTOR * chord + arm.radii[s] + CONTACT_MARGIN
            if gaps[k, s] < needed or gaps[k + 1, s] < needed:
                may_collide[k] = True
