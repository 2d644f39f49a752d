"""The known geometry of a target, made ready for finding it among points."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from coopmap_env.geometry import Pose, rotation_about_z

_R2_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Of the R2 sequence, which fills a square evenly (Roberts 2018): powers of the plastic number."""
_SYMMETRY_ORDERS = (2, 3, 4, 5, 6, 8)
"""Turns by 360 degrees over these are tried as symmetries."""


@dataclass(frozen=True, eq=False)
class TargetModel:
    """The surface of a target in its own frame: front +x, z up, ground at z = 0.

    Parameters
    ----------
    triangles : ndarray, shape (m, 3, 3)
        Corners, metres, anticlockwise as seen from outside. Copied and read-only.
    spacing : float
        Metres between neighbouring samples of the surface.
    symmetry_tolerance : float
        Metres by which a motion may miss the target that maps it onto itself.

    Raises
    ------
    ValueError
        If there is no triangle with an area, or a value is not finite or not positive.
    """

    triangles: NDArray[np.float64]
    spacing: float = 0.04
    """Half the width of the thinnest bar of the worksite's panel."""
    symmetry_tolerance: float = 0.05
    """About the range noise of Eq. 1 at 5 m: what is smaller cannot be told apart."""

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
        normals, areas = _normals(triangles)
        if not (areas > 0).any():
            raise ValueError(f"none of the {len(triangles)} triangles has an area")
        triangles = triangles[areas > 0]
        triangles.setflags(write=False)
        object.__setattr__(self, "triangles", triangles)
        object.__setattr__(self, "_normals", normals[areas > 0])
        object.__setattr__(self, "_areas", areas[areas > 0])

    @property
    def normals(self) -> NDArray[np.float64]:
        """Outward unit normals (m, 3) of the triangles."""
        normals: NDArray[np.float64] = self.__dict__["_normals"]
        return normals

    @cached_property
    def plane_points(self) -> NDArray[np.float64]:
        """A corner (m, 3) of each triangle: a point of its plane."""
        return np.ascontiguousarray(self.triangles[:, 0])

    @property
    def area(self) -> float:
        """Square metres of the surface."""
        return float(self.__dict__["_areas"].sum())

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner (2, 3) of the box around the target."""
        return np.stack([self.triangles.min(axis=(0, 1)), self.triangles.max(axis=(0, 1))])

    @property
    def center_xy(self) -> NDArray[np.float64]:
        """Middle (2,) of the box around the target, x and y."""
        return np.asarray(self.bounds[:, :2].mean(axis=0))

    @cached_property
    def samples(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Points (n, 3) about `spacing` apart on the surface, and their unit normals (n, 3)."""
        return self.sample_surface(max(round(self.area / self.spacing**2), 64))

    def sample_surface(self, n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """N points (n, 3) that share the surface evenly, and their unit normals (n, 3).

        Each stands for the same area; where in its triangle it lies is told by the R2 sequence, so
        that the same target always has the same samples.
        """
        cumulative_areas = np.cumsum(self.__dict__["_areas"])
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
        """Of the samples' points."""
        return cKDTree(self.samples[0])

    @cached_property
    def symmetries(self) -> tuple[Pose, ...]:
        """Motions over the ground that map the target onto itself; the identity is the first.

        Such a motion leaves the middle of the surface where it is, so only turns about that are
        tried: those by 360 degrees over 2 to 6 and 8, and their multiples. A target that is round
        has more; its yaw cannot be found, which `register` tells by the lack of evidence.
        """
        points = self.samples[0]
        subset = points[:: max(len(points) // 200, 1)]
        centre = points.mean(axis=0) * [1.0, 1.0, 0.0]
        # another sample is at most about a spacing away on the same surface
        limit = self.symmetry_tolerance + self.spacing
        found = [Pose(np.zeros(3), np.eye(3))]
        for angle in _rotation_angles(_SYMMETRY_ORDERS):
            R = rotation_about_z(angle)
            motion = Pose(centre - R @ centre, R)
            if all(
                self._all_near_surface(motion.transform(candidate_points), limit)
                for candidate_points in (subset, points)
            ):
                found.append(motion)
        return tuple(found)

    def _all_near_surface(self, points: NDArray[np.float64], limit: float) -> bool:
        """Whether a sample lies within a limit of each point."""
        distances = self.kd_tree.query(points, distance_upper_bound=limit)[0]
        return bool(np.isfinite(distances).all())


def _rotation_angles(orders: Iterable[int]) -> list[float]:
    """All multiples of a turn over each fold, between nothing and a whole turn, radians."""
    multiples = {k * 120 // n for n in orders for k in range(1, n)}  # 120: a multiple of each fold
    return [2.0 * math.pi * share / 120 for share in sorted(multiples)]


def _normals(triangles: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Unit normals (m, 3) and areas (m,) of triangles; the normal is 0 where there is no area."""
    a, b, c = np.moveaxis(np.asarray(triangles), 1, 0)
    cross = np.cross(b - a, c - a)
    twice = np.linalg.norm(cross, axis=1)
    areas = np.where(twice > 1e-12, 0.5 * twice, 0.0)
    return cross / np.maximum(twice, 1e-12)[:, None], areas
