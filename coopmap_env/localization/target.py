"""Known geometry of a target, with what registration needs of it: samples, planes, symmetries."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.limits import check_bytes
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose, rotation_about_z

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

Array = NDArray[np.float64]

_R2_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Steps of the R2 sequence (Roberts 2018), which fills a square evenly: powers of the plastic
number."""
_BYTES_PER_SAMPLE = 200
"""Of a point of the surface with its normal, while it is drawn and in a search tree."""
_SYMMETRY_ORDERS = (2, 3, 4, 5, 6, 8)
"""Rotations by 360 degrees over these are tried as symmetries."""


class TargetPlanes(NamedTuple):
    """Planes of a target's m triangles, for kernels."""

    normals: Array
    """Shape (m, 3): outward unit normals."""
    points: Array
    """Shape (m, 3): a point of each plane, metres."""


@dataclass(frozen=True, eq=False)
class TargetModel:
    """The surface of a target in its own frame: front +x, z up, ground at z = 0.

    Parameters
    ----------
    triangles : ndarray, shape (m, 3, 3)
        Corners, metres, anticlockwise as seen from outside. Copied and read-only; triangles
        without an area are left out.
    spacing : float
        Metres between neighbouring samples of the surface.
    symmetry_tolerance : float
        Metres by which the image of the target under a symmetry may differ from the target.

    Raises
    ------
    ValueError
        If there is no triangle with an area, or a value is not finite or not positive.
    """

    triangles: Array
    spacing: float = 0.04
    """Half the width of the thinnest bar of the worksite's panel."""
    symmetry_tolerance: float = 0.05
    """About the range noise of Eq. 1 at 5 m: smaller differences cannot be measured."""
    normals: Array = field(init=False, repr=False)
    """Outward unit normals (m, 3) of the triangles."""
    areas: Array = field(init=False, repr=False)
    """Areas (m,) of the triangles, square metres."""

    def __post_init__(self) -> None:
        triangles = np.array(self.triangles, dtype=np.float64)
        if triangles.ndim != 3 or triangles.shape[1:] != (3, 3) or not len(triangles):
            raise ValueError(f"a target needs triangles (m, 3, 3), got {triangles.shape}")
        if not np.isfinite(triangles).all():
            raise ValueError("a target needs triangles of finite corners")
        for name in ("spacing", "symmetry_tolerance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"TargetModel.{name} must be finite and > 0, got {value}")
        normals, areas = _normals_and_areas(triangles)
        if not (areas > 0).any():
            raise ValueError(f"none of the {len(triangles)} triangles has an area")
        triangles = triangles[areas > 0]
        triangles.setflags(write=False)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "normals", freeze(normals[areas > 0]))
        object.__setattr__(self, "areas", freeze(areas[areas > 0]))

    @cached_property
    def planes(self) -> TargetPlanes:
        """Planes of the triangles."""
        return freeze(TargetPlanes(self.normals, np.ascontiguousarray(self.triangles[:, 0])))

    @property
    def area(self) -> float:
        """Square metres of the surface."""
        return float(self.areas.sum())

    @cached_property
    def bounds(self) -> Array:
        """Lower and upper corner (2, 3) of the target's bounding box, metres."""
        return freeze(np.stack([self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1))]))

    @property
    def center_xy(self) -> Array:
        """Center (2,) of the bounding box, x and y, metres."""
        return np.asarray(self.bounds[:, :2].mean(axis=0))

    @cached_property
    def samples(self) -> tuple[Array, Array]:
        """Points (n, 3) about `spacing` apart on the surface, and their unit normals (n, 3).

        Raises
        ------
        ValueError
            If they do not fit into the limit of `coopmap_env.core.limits`.
        """
        n = max(round(self.area / self.spacing**2), 64)
        what = f"samples {self.spacing:g} m apart of a target with {self.area:.3g} m2 of surface"
        check_bytes(n * _BYTES_PER_SAMPLE, what)
        return freeze(self.sample_surface(n))

    def sample_surface(self, n: int) -> tuple[Array, Array]:
        """N points (n, 3), evenly on the surface, and their unit normals (n, 3).

        Each stands for the same area. Its position in its triangle follows from the R2 sequence,
        so the same target always has the same samples.
        """
        cumulative_areas = np.cumsum(self.areas)
        triangle = np.searchsorted(
            cumulative_areas, (np.arange(n) + 0.5) / n * cumulative_areas[-1]
        )
        triangle = np.minimum(triangle, len(cumulative_areas) - 1)
        u, v = ((np.arange(n)[:, None] + 1.0) * _R2_STEPS % 1.0).T
        outside = u + v > 1.0
        u, v = np.where(outside, 1.0 - u, u), np.where(outside, 1.0 - v, v)
        a, b, c = np.moveaxis(self.triangles[triangle], 1, 0)
        points = a + u[:, None] * (b - a) + v[:, None] * (c - a)
        return points, self.normals[triangle]

    @cached_property
    def kd_tree(self) -> cKDTree:
        """Tree of the samples' points, for nearest neighbours."""
        from scipy.spatial import cKDTree  # a third of a second, seldom needed

        return cKDTree(self.samples[0])

    @cached_property
    def symmetries(self) -> tuple[Pose, ...]:
        """Rotations about z that map the target onto itself; the identity is the first.

        They keep the center of the surface, so only rotations about it are tried: those by 360
        degrees over 2 to 6 and 8, and their multiples. A round target has more of them; its yaw
        cannot be found, which `register` reports as a lack of evidence.
        """
        points = self.samples[0]
        subset = points[:: max(len(points) // 200, 1)]
        center = points.mean(axis=0) * [1.0, 1.0, 0.0]
        # another sample is at most about a spacing away on the same surface
        limit = self.symmetry_tolerance + self.spacing
        symmetries = [Pose.identity()]
        for angle in _rotation_angles(_SYMMETRY_ORDERS):
            R = rotation_about_z(angle)
            rotation = Pose(center - product(R, center), R)
            # the subset first: it rejects most angles at once
            if all(self._covers(rotation.transform(some), limit) for some in (subset, points)):
                symmetries.append(rotation)
        return tuple(symmetries)

    def _covers(self, points: Array, limit: float) -> bool:
        """Whether each point has a sample within a limit."""
        distances = self.kd_tree.query(points, distance_upper_bound=limit)[0]
        return bool(np.isfinite(distances).all())


def _rotation_angles(orders: Iterable[int]) -> list[float]:
    """Angles of all rotations of the given orders, in (0, 2 pi), ascending, radians."""
    # in units of 3 degrees: 120 is a multiple of each order
    multiples = {k * 120 // n for n in orders for k in range(1, n)}
    return [2.0 * math.pi * multiple / 120 for multiple in sorted(multiples)]


def _normals_and_areas(triangles: ArrayLike) -> tuple[Array, Array]:
    """Unit normals (m, 3) and areas (m,) of triangles; the normal is 0 where there is no area."""
    a, b, c = np.moveaxis(np.asarray(triangles), 1, 0)
    cross = np.cross(b - a, c - a)
    double_areas = np.linalg.norm(cross, axis=1)
    areas = np.where(double_areas > 1e-12, 0.5 * double_areas, 0.0)
    return cross / np.maximum(double_areas, 1e-12)[:, None], areas
