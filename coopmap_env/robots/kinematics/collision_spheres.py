"""Collision geometry of a vehicle: spheres that cover its links."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.core.settings import Bounds, Positive, Settings
from coopmap_env.robots.kinematics.chain import Chain


@dataclass(frozen=True)
class CollisionSphereSettings(Settings):
    """How finely links are covered.

    Raises
    ------
    ValueError
        If a value is not positive.
    """

    radius: Positive = 0.15
    """Metres: parts of moving links are halved until their spheres are no larger."""
    static_radius: Positive = 0.2
    """Metres, the same for links that do not move: only the mount's own links can touch them."""
    max_spheres: Annotated[int, Bounds(at_least=1, largest=1_000)] = 8
    """Spheres per link, whatever their radius."""


class PartnerRanges(NamedTuple):
    """For each sphere (s,) its slice of `CollisionSpheres.partners`."""

    start: NDArray[np.int64]
    first_moving: NDArray[np.int64]
    """Partners before this one are static."""
    end: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class CollisionSpheres:
    """Spheres fixed to the links of a chain; those that no joint moves come first.

    The spheres of each rigid body cover all triangles of its links; a sphere inside another one is
    left out.
    """

    chain: Chain
    sphere_body_index: NDArray[np.int64]
    """Shape (s,): the rigid body of the chain that each sphere is fixed to; 0 does not move."""
    local_centers: NDArray[np.float64]
    """Shape (s, 3), in the frames of those bodies."""
    radii: NDArray[np.float64]
    """Shape (s,), metres."""
    link: NDArray[np.int64]
    """Shape (s,): index in `chain.link_names`."""
    partners: NDArray[np.int64]
    """Shape (p,): spheres that moving ones must not touch, by moving sphere, static ones first."""
    partner_ranges: PartnerRanges
    static_center: NDArray[np.float64]
    """Shape (3,): center of a sphere around all static ones, base frame."""
    static_radius: float
    """Metres, of that sphere."""

    @classmethod
    def from_chain(
        cls, chain: Chain, home: Sequence[float], settings: CollisionSphereSettings | None = None
    ) -> CollisionSpheres:
        """Cover the links of a chain, once per process.

        Spheres that overlap at `home` touch by construction: such pairs are not checked, nor are
        those of joined links, which the joints' limits keep apart.
        """
        return _cover_chain(
            chain, tuple(float(v) for v in home), settings or CollisionSphereSettings()
        )

    @property
    def n_spheres(self) -> int:
        """Number of spheres."""
        return len(self.radii)

    @property
    def pairs(self) -> NDArray[np.int64]:
        """Pairs (p, 2) of a moving sphere and another one that it must not touch."""
        counts = self.partner_ranges.end - self.partner_ranges.start
        return np.stack([np.repeat(np.arange(self.n_spheres), counts), self.partners], axis=1)

    def checked_link_pairs(self) -> set[frozenset[str]]:
        """Names of the two links of every pair."""
        names = self.chain.link_names
        return {frozenset((names[a], names[b])) for a, b in self.link[self.pairs].tolist()}

    @property
    def n_static_spheres(self) -> int:
        """Number of spheres that no joint moves; they come first."""
        return int(np.count_nonzero(self.sphere_body_index == 0))

    def centers(self, q: ArrayLike) -> NDArray[np.float64]:
        """Centers (k, s, 3) in the base frame; (s, 3) for a single q (n,)."""
        out = self.chain.point_positions(q, self.sphere_body_index, self.local_centers)
        return out if np.ndim(q) == 2 else out[0]


@lru_cache(maxsize=32)
def _cover_chain(
    chain: Chain, home: tuple[float, ...], settings: CollisionSphereSettings
) -> CollisionSpheres:
    rows: list[tuple[int, NDArray[np.float64], float, int]] = []
    for link, triangles in enumerate(chain.meshes):
        if not len(triangles):
            continue
        body = int(chain.link_body[link])
        limit = settings.radius if body else settings.static_radius
        R, t = chain.link_rotations[link], chain.link_translations[link]
        for center, radius in cover_with_spheres(triangles, limit, settings.max_spheres):
            rows.append((body, product(R, center) + t, radius, link))
    if not rows:
        raise ValueError("no link has a shape, so no collision can be checked")
    rows = [row for row in rows if not any(_contains_sphere(other, row) for other in rows)]
    rows.sort(key=lambda row: row[0] != 0)
    bodies = np.array([row[0] for row in rows], dtype=np.int64)
    centers, radii = np.array([row[1] for row in rows]), np.array([row[2] for row in rows])
    at_home = chain.point_positions(home, bodies, centers)[0]
    partners, partner_ranges = _collision_pairs(chain.tree.parent, bodies, at_home, radii)
    static = bodies == 0
    static_center, static_radius = _bounding_sphere_of_spheres(at_home[static], radii[static])
    spheres = CollisionSpheres(
        chain=chain,
        sphere_body_index=bodies,
        local_centers=centers,
        radii=radii,
        link=np.array([row[3] for row in rows], dtype=np.int64),
        partners=partners,
        partner_ranges=partner_ranges,
        static_center=static_center,
        static_radius=static_radius,
    )
    return freeze(spheres)


def _contains_sphere(
    other: tuple[int, NDArray[np.float64], float, int],
    row: tuple[int, NDArray[np.float64], float, int],
) -> bool:
    """Whether a sphere lies inside a larger one on the same rigid body."""
    gap = length(other[1] - row[1])
    return other[0] == row[0] and other[2] > row[2] and gap + row[2] <= other[2]


def _collision_pairs(
    parent: NDArray[np.int64],
    body: NDArray[np.int64],
    centers: NDArray[np.float64],
    radii: NDArray[np.float64],
) -> tuple[NDArray[np.int64], PartnerRanges]:
    """Partners and their ranges: spheres apart at home whose bodies are not joined.

    Two moving bodies with one between them count as joined: the axes of a wrist lie close.
    """
    n = len(parent)
    joined = np.eye(n, dtype=np.bool_)
    for b in range(1, n):
        joined[b, parent[b]] = joined[parent[b], b] = True
        above = parent[parent[b]]
        if parent[b] > 0 and above > 0:
            joined[b, above] = joined[above, b] = True
    gaps = np.linalg.norm(centers[:, None] - centers, axis=2) - radii[:, None] - radii
    checked = (gaps > 0) & ~joined[body[:, None], body] & (body[:, None] > 0)
    checked &= np.tri(
        len(body), k=-1, dtype=np.bool_
    )  # static spheres come first, so they are second here
    static, ends = checked[:, body == 0].sum(axis=1), checked.sum(axis=1).cumsum()
    begins = np.concatenate([[0], ends[:-1]])
    return np.nonzero(checked)[1], PartnerRanges(begins, begins + static, ends)


def _bounding_sphere_of_spheres(
    centers: NDArray[np.float64], radii: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float]:
    """Center (3,) and radius of a sphere around spheres; far away and empty if there are none."""
    if not len(radii):
        return np.array([1e9, 1e9, 1e9]), 0.0
    middle = 0.5 * ((centers - radii[:, None]).min(axis=0) + (centers + radii[:, None]).max(axis=0))
    return middle, float((np.linalg.norm(centers - middle, axis=1) + radii).max())


def cover_with_spheres(
    triangles: NDArray[np.float64], radius: float, max_spheres: int
) -> list[tuple[NDArray[np.float64], float]]:
    """Spheres (center, radius) whose union covers triangles (m, 3, 3).

    The part with the largest sphere is cut across its longest side, triangles with it, until no
    sphere is larger than `radius` or there are `max_spheres`.
    """
    parts = [(_bounding_sphere(triangles), triangles)]
    while len(parts) < max_spheres:
        worst = max(range(len(parts)), key=lambda i: parts[i][0][1])
        (_, largest), cut = parts[worst]
        if largest <= radius:
            break
        points = cut.reshape(-1, 3)
        lower, upper = points.min(axis=0), points.max(axis=0)
        axis = int(np.argmax(upper - lower))
        level = 0.5 * (lower[axis] + upper[axis])
        halves = [_clip_triangles(cut, axis, level, sign) for sign in (1.0, -1.0)]
        parts[worst : worst + 1] = [(_bounding_sphere(half), half) for half in halves if len(half)]
    return [ball for ball, _ in parts]


def _clip_triangles(
    triangles: NDArray[np.float64], axis: int, level: float, sign: float
) -> NDArray[np.float64]:
    """The part of triangles beyond a plane normal to an axis: ``sign * (x - level) >= 0``."""
    side = sign * (triangles[:, :, axis] - level)
    inside = side >= 0
    count = inside.sum(axis=1)
    whole = triangles[count == 3]
    pieces = [whole]
    for wanted in (1, 2):
        cut = triangles[count == wanted]
        if not len(cut):
            continue
        # rotate each so that the vertex that is alone on its side comes first
        alone = (inside[count == wanted] == (wanted == 1)).argmax(axis=1)
        order = (alone[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(cut, order[:, :, None], axis=1), 1, 0)
        offset = np.take_along_axis(side[count == wanted], order, axis=1)
        ab = a + (b - a) * (offset[:, 0] / (offset[:, 0] - offset[:, 1]))[:, None]
        ac = a + (c - a) * (offset[:, 0] / (offset[:, 0] - offset[:, 2]))[:, None]
        if wanted == 1:
            pieces.append(np.stack([a, ab, ac], axis=1))
        else:
            pieces += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(pieces)


def _bounding_sphere(triangles: NDArray[np.float64]) -> tuple[NDArray[np.float64], float]:
    """A sphere around all vertices, close to the smallest one.

    Ever shorter steps towards the farthest vertex find the smallest sphere's center (Badoiu and
    Clarkson 2003); the radius is measured, so that the sphere contains all vertices.
    """
    points = np.unique(triangles.reshape(-1, 3), axis=0)
    center = 0.5 * (points.min(axis=0) + points.max(axis=0))
    best = center
    distance = np.linalg.norm(points - center, axis=1)
    smallest = float(distance.max())
    for step in range(1, 60):
        center = center + (points[distance.argmax()] - center) / (step + 1)
        distance = np.linalg.norm(points - center, axis=1)
        if distance.max() < smallest:
            best, smallest = center, float(distance.max())
    return best, smallest * (1.0 + 1e-9)
