"""A fast test of a mount's motion: where it could touch anything, by spheres and boxes."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import PlainTuple
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.geometry import RigidTransform, Spheres
from coopmap_env.robots import Chain, KinematicTree
from coopmap_env.simulation.physics._sweep import (
    LinkSpheres,
    OwnBoxes,
    SweepObstacles,
    mark_swept_collisions,
    write_sphere_centers,
)


def covering_spheres(box: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """Centers (n, 3) and radius of spheres in a row along a box's (2, 3) longest side."""
    size = box[1] - box[0]
    longest = int(size.argmax())
    n = max(1, math.ceil(size[longest] / max(np.sort(size)[1], 1e-3)))
    n = min(n, 16)
    centers = np.tile(box.mean(axis=0), (n, 1))
    centers[:, longest] = box[0, longest] + size[longest] * (np.arange(n) + 0.5) / n
    size[longest] /= n
    return centers, float(length(size) / 2)


@dataclass(frozen=True, eq=False)
class SweepModel:
    """Spheres around the links of one mount, and boxes around the body that carries it."""

    tree: KinematicTree
    links: LinkSpheres
    """Around all links; those of the mount come first."""
    arm: LinkSpheres
    """Around the links that the mount moves."""
    own: OwnBoxes

    @classmethod
    def from_link_boxes(
        cls,
        chain: Chain,
        boxes: Mapping[str, NDArray[np.float64]],
        arm: Collection[str],
        ignored_pairs: Collection[tuple[str, str]],
    ) -> SweepModel:
        """Make the model from boxes (2, 3) around links, in their frames.

        `arm` names the links that the mount moves; `ignored_pairs` are pairs of a link of the arm
        and one of the body.
        """
        names = [*(n for n in boxes if n in arm), *(n for n in boxes if n not in arm)]
        rows: list[tuple[str, int, NDArray[np.float64], float]] = []
        own: list[tuple[str, int, NDArray[np.float64]]] = []
        for name in names:
            link = chain.link_names.index(name)
            R, t = chain.link_rotations[link], chain.link_translations[link]
            body = int(chain.link_body[link])
            centers, radius = covering_spheres(boxes[name])
            rows += [(name, body, product(R, center) + t, radius) for center in centers]
            if name not in arm:
                middle, half = boxes[name].mean(axis=0), np.diff(boxes[name], axis=0)[0] / 2
                half_in_body = product(np.abs(R), half)
                center = product(R, middle) + t
                own.append((name, body, np.stack([center - half_in_body, center + half_in_body])))
        mount = [row for row in rows if row[0] in arm]
        links = LinkSpheres(
            bodies=np.array([row[1] for row in rows], dtype=np.int64),
            offsets=np.array([row[2] for row in rows]).reshape(-1, 3),
            radii=np.array([row[3] for row in rows]),
        )
        n = len(mount)
        return cls(
            tree=chain.tree,
            links=links,
            arm=LinkSpheres(links.bodies[:n], links.offsets[:n], links.radii[:n]),
            own=OwnBoxes(
                boxes=np.array([row[2] for row in own]).reshape(-1, 2, 3),
                bodies=np.array([row[1] for row in own], dtype=np.int64),
                checked_pairs=np.array(
                    [[(row[0], other[0]) not in ignored_pairs for other in own] for row in mount],
                    dtype=np.bool_,
                ).reshape(n, len(own)),
            ),
        )

    @cached_property
    def plain(self) -> PlainTuple:
        """Tree, spheres of the arm and own boxes, for `mark_swept_collisions`."""
        return tuple(self.tree), tuple(self.arm), tuple(self.own)

    def spheres(self, T_world_base: RigidTransform, q: NDArray[np.float64]) -> Spheres:
        """Spheres in the world around all links at q (m,)."""
        centers = np.empty((len(self.links.bodies), 3))
        write_sphere_centers(self.plain[0], tuple(T_world_base), q, tuple(self.links), centers)
        return Spheres(centers, self.links.radii)

    def swept_collisions(
        self, T_world_base: RigidTransform, q: NDArray[np.float64], obstacles: SweepObstacles
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Marks (k - 1,) of what may touch between configurations q (k, m); metres travelled."""
        may_collide, travel = np.empty(len(q) - 1, dtype=np.bool_), np.empty(len(q) - 1)
        mark_swept_collisions(
            self.plain,
            tuple(T_world_base),
            q,
            obstacles.boxes,
            tuple(obstacles.spheres),
            may_collide,
            travel,
        )
        return may_collide, travel
