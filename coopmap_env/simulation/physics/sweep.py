"""Which stretches of a mount's motion could touch anything: a quick no by spheres and boxes.

Links are covered by spheres; at a few configurations along the motion their gaps to the boxes
around all solids, to the spheres of other vehicles and to the boxes of the own body are compared
with how far each moves in between. Only where a gap is too small does the physics engine look.
The answer errs to one side only: a stretch without a mark touches nothing.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.forward import KinematicTree, allocate_body_poses, body_poses

ARC_FACTOR = 0.55
"""Of the chord between two configurations: no point of the arc is further from both its ends, for
arcs of less than a quarter turn; half the chord would be a straight line's."""
CONTACT_MARGIN = 0.005
"""Metres: more than the margins that the physics engine puts around its shapes."""


@njit(cache=True, nogil=True)
def squared_distance_to_box(x, y, z, lower, upper):
    """From a point to a box, squared; 0 within."""
    dx = max(lower[0] - x, 0.0, x - upper[0])
    dy = max(lower[1] - y, 0.0, y - upper[1])
    dz = max(lower[2] - z, 0.0, z - upper[2])
    return dx * dx + dy * dy + dz * dz


@njit(cache=True, nogil=True)
def sphere_centers(tree, base_R, base_t, q, sphere_bodies, sphere_offsets, work, out):
    """Centres (s, 3) of spheres fixed to bodies at one q, world frame; the root stands at base."""
    R, t = work[0], work[1]
    R[0] = base_R
    t[0] = base_t
    body_poses(tree, q, *work)
    for s in range(len(sphere_bodies)):
        b = sphere_bodies[s]
        x, y, z = sphere_offsets[s, 0], sphere_offsets[s, 1], sphere_offsets[s, 2]
        for i in range(3):
            out[s, i] = t[b, i] + R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z


@njit(cache=True, nogil=True)
def squared_distance_to_body(x, y, z, body_boxes, body_box_frames, checked_pairs, R, t):
    """Square of the distance from a point of the world to the nearest box of the own body."""
    best = math.inf
    for o in range(len(body_boxes)):
        if checked_pairs[o]:
            b = body_box_frames[o]
            dx, dy, dz = x - t[b, 0], y - t[b, 1], z - t[b, 2]
            px = R[b, 0, 0] * dx + R[b, 1, 0] * dy + R[b, 2, 0] * dz
            py = R[b, 0, 1] * dx + R[b, 1, 1] * dy + R[b, 2, 1] * dz
            pz = R[b, 0, 2] * dx + R[b, 1, 2] * dy + R[b, 2, 2] * dz
            best = min(
                best, squared_distance_to_box(px, py, pz, body_boxes[o, 0], body_boxes[o, 1])
            )
    return best


@njit(cache=True, nogil=True)
def mark_swept_collisions(shape, base_R, base_t, q, boxes, others, may_collide, travel):
    """Mark the stretches between configurations q (k, m) in which something may touch.

    `shape` is `SweepModel.arrays`; `boxes` (b, 2, 3) and `others` (o, 4), centres and radii, are what
    is in the way; `travel` (k - 1,) receives how far the fastest sphere goes, as the crow flies.
    """
    tree, sphere_bodies, sphere_offsets, radii, body_boxes, body_box_frames, checked_pairs = shape
    n, n_spheres = len(q), len(sphere_bodies)
    work = allocate_body_poses(tree)
    at = np.empty((n, n_spheres, 3))
    gaps = np.full((n, n_spheres), math.inf)
    for k in range(n):
        sphere_centers(tree, base_R, base_t, q[k], sphere_bodies, sphere_offsets, work, at[k])
        for s in range(n_spheres):
            x, y, z = at[k, s, 0], at[k, s, 1], at[k, s, 2]
            gaps[k, s] = squared_distance_to_body(
                x, y, z, body_boxes, body_box_frames, checked_pairs[s], work[0], work[1]
            )
    lower, upper = np.empty(3), np.empty(3)
    for s in range(n_spheres):
        # everything that this sphere's whole way comes near to
        reach = 0.0
        for k in range(n - 1):
            reach = max(reach, np.sqrt(((at[k + 1, s] - at[k, s]) ** 2).sum()))
        reach = ARC_FACTOR * reach + radii[s] + CONTACT_MARGIN
        for i in range(3):
            lower[i], upper[i] = at[:, s, i].min() - reach, at[:, s, i].max() + reach
        for b in range(len(boxes)):
            if (
                (boxes[b, 0] < upper).all() and (boxes[b, 1] > lower).all()
            ):  # fmt: skip
                for k in range(n):
                    p = at[k, s]
                    d = squared_distance_to_box(p[0], p[1], p[2], boxes[b, 0], boxes[b, 1])
                    gaps[k, s] = min(gaps[k, s], d)
        for k in range(n):
            gaps[k, s] = math.sqrt(gaps[k, s])
        for o in range(len(others)):
            x, y, z, r = others[o, 0], others[o, 1], others[o, 2], others[o, 3]
            if squared_distance_to_box(x, y, z, lower, upper) < r * r:
                for k in range(n):
                    dx, dy, dz = at[k, s, 0] - x, at[k, s, 1] - y, at[k, s, 2] - z
                    gaps[k, s] = min(gaps[k, s], math.sqrt(dx * dx + dy * dy + dz * dz) - r)
    for k in range(n - 1):
        may_collide[k] = False
        travel[k] = 0.0
        for s in range(n_spheres):
            chord = np.sqrt(((at[k + 1, s] - at[k, s]) ** 2).sum())
            travel[k] = max(travel[k], chord)
            needed = ARC_FACTOR * chord + radii[s] + CONTACT_MARGIN
            if gaps[k, s] < needed or gaps[k + 1, s] < needed:
                may_collide[k] = True


def covering_spheres(box: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centres (n, 3) and radius of spheres in a row along a box's (2, 3) longest side."""
    size = box[1] - box[0]
    longest = int(size.argmax())
    n = max(1, math.ceil(size[longest] / max(np.sort(size)[1], 1e-3)))
    n = min(n, 16)
    centers = np.tile(box.mean(axis=0), (n, 1))
    centers[:, longest] = box[0, longest] + size[longest] * (np.arange(n) + 0.5) / n
    size[longest] /= n
    return centers, float(np.linalg.norm(size) / 2)


@dataclass(frozen=True, eq=False)
class SweepModel:
    """Spheres around the links of one mount, and boxes around the body that carries it."""

    tree: KinematicTree
    sphere_bodies: NDArray[np.int64]
    """Shape (s,): the rigid body of each sphere; the mount's come first."""
    sphere_offsets: NDArray[np.float64]
    """Shape (s, 3): their centres, in the frames of their bodies."""
    radii: NDArray[np.float64]
    n_arm: int
    """How many of the spheres are the mount's."""
    body_boxes: NDArray[np.float64]
    """Shape (o, 2, 3): boxes of the vehicle's body, in the frames of rigid bodies `body_box_frames`."""
    body_box_frames: NDArray[np.int64]
    checked_pairs: NDArray[np.bool_]
    """Shape (n_arm, o): which pairs can touch at all; neighbours cannot."""

    @classmethod
    def from_link_boxes(
        cls,
        chain: Chain,
        boxes: Mapping[str, NDArray[np.float64]],
        arm: Collection[str],
        ignored_pairs: Collection[tuple[str, str]],
    ) -> SweepModel:
        """From boxes (2, 3) around links, in their frames; `arm` names those that the mount moves.

        `ignored_pairs` are pairs of a link of the arm and one of the body.
        """
        names = [*(n for n in boxes if n in arm), *(n for n in boxes if n not in arm)]
        rows: list[tuple[str, int, NDArray[np.float64], float]] = []
        body_boxes: list[tuple[str, int, NDArray[np.float64]]] = []
        for name in names:
            link = chain.link_names.index(name)
            R, t = chain.link_rotations[link], chain.link_translations[link]
            body = int(chain.link_body[link])
            centers, radius = covering_spheres(boxes[name])
            rows += [(name, body, R @ center + t, radius) for center in centers]
            if name not in arm:
                middle, half = boxes[name].mean(axis=0), np.diff(boxes[name], axis=0)[0] / 2
                around = np.abs(R) @ half
                at = R @ middle + t
                body_boxes.append((name, body, np.stack([at - around, at + around])))
        mount = [row for row in rows if row[0] in arm]
        return cls(
            tree=chain.tree,
            sphere_bodies=np.array([row[1] for row in rows], dtype=np.int64),
            sphere_offsets=np.array([row[2] for row in rows]).reshape(-1, 3),
            radii=np.array([row[3] for row in rows]),
            n_arm=len(mount),
            body_boxes=np.array([row[2] for row in body_boxes]).reshape(-1, 2, 3),
            body_box_frames=np.array([row[1] for row in body_boxes], dtype=np.int64),
            checked_pairs=np.array(
                [[(row[0], other[0]) not in ignored_pairs for other in body_boxes] for row in mount]
            ).reshape(len(mount), len(body_boxes)),
        )

    def spheres(
        self, R: NDArray[np.float64], t: NDArray[np.float64], q: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Centres and radii (s, 4) in the world of all spheres at q (m,), the base at R, t."""
        out = np.empty((len(self.sphere_bodies), 4))
        sphere_centers(
            self.tree,
            R,
            t,
            q,
            self.sphere_bodies,
            self.sphere_offsets,
            allocate_body_poses(self.tree),
            out,
        )
        out[:, 3] = self.radii
        return out

    def swept_collisions(
        self,
        R: NDArray[np.float64],
        t: NDArray[np.float64],
        q: NDArray[np.float64],
        boxes: NDArray[np.float64],
        others: NDArray[np.float64],
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Marks (k - 1,) of what may touch between configurations q (k, m); how far each goes."""
        may_collide, travel = np.empty(len(q) - 1, dtype=np.bool_), np.empty(len(q) - 1)
        n = self.n_arm
        arrays = (
            self.tree, self.sphere_bodies[:n], self.sphere_offsets[:n], self.radii[:n],
            self.body_boxes, self.body_box_frames, self.checked_pairs,
        )  # fmt: skip
        mark_swept_collisions(arrays, R, t, q, boxes, others, may_collide, travel)
        return may_collide, travel
