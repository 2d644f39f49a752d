"""Points sampled evenly over the true surface of a field world."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field import FieldWorld

BOX_SIDES = tuple((axis, sign) for axis in range(3) for sign in (1.0, -1.0))


@dataclass(frozen=True, eq=False)
class SurfaceSamples:
    """Points on the surface inside a grid, each for an equal part of its area.

    Faces that touch other solids or lie inside them have points too. No camera sees these, so they
    are not part of the visible surface.
    """

    points: NDArray[np.float64]
    """Shape (n, 3), metres, world frame."""
    normals: NDArray[np.float64]
    """Shape (n, 3), unit vectors, outward if the solids' faces are."""
    solid_index: NDArray[np.int64]
    """Shape (n,): the solid of the surface, index in `FieldWorld.solids`."""
    is_target: NDArray[np.bool_]
    """Shape (n,): whether that solid belongs to the target."""
    area: float
    """Square metres of the whole surface inside the grid."""

    def __len__(self) -> int:
        return len(self.points)


def sample_surface(world: FieldWorld, rng: np.random.Generator, n: int = 20_000) -> SurfaceSamples:
    """Draw points on the surface of a world, inside its grid (stratified by area).

    The area is laid out as one interval and divided into n equal parts, each with one random point.
    The number of points on a triangle is proportional to its area to within two, so fractions of
    the surface have a smaller error than with independent points.

    Parameters
    ----------
    world : FieldWorld
    rng : numpy.random.Generator
    n : int
        Points; the default is about one for each voxel face of the default grid's surface.

    Raises
    ------
    ValueError
        If n is below 1, or no surface lies inside the grid.
    """
    if n < 1:
        raise ValueError(f"n must be at least 1, got {n}")
    counts = [len(solid.faces) for solid in world.solids]
    solid_of_triangle = np.repeat(np.arange(len(counts)), counts)
    triangles, source = clip_triangles(world.triangles, world.grid)
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    double_area = np.linalg.norm(normals, axis=1)
    cumulative_area = np.cumsum(double_area)
    if not (len(cumulative_area) and cumulative_area[-1] > 0):
        raise ValueError(f"no surface of {world.name!r} lies inside the grid {world.grid}")
    offsets = (np.arange(n) + rng.random(n)) * (cumulative_area[-1] / n)
    chosen = np.minimum(
        np.searchsorted(cumulative_area, offsets, side="right"), len(cumulative_area) - 1
    )
    u, v = rng.random((2, n))
    root = np.sqrt(u)[:, None]  # uniform over the triangle, not over its two parameters
    side = a[chosen] + v[:, None] * (b[chosen] - a[chosen])
    points = c[chosen] + root * (side - c[chosen])
    solid = solid_of_triangle[source[chosen]]
    is_target = np.array([one.is_target for one in world.solids])
    return SurfaceSamples(
        points,
        normals[chosen] / double_area[chosen, None],
        solid,
        is_target[solid],
        float(cumulative_area[-1]) / 2,
    )


def clip_triangles(
    triangles: ArrayLike, grid: VoxelGrid
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Clip triangles (m, 3, 3) at the sides of a grid.

    Returns
    -------
    triangles : ndarray, shape (k, 3, 3)
        The parts inside, with the orientation of their triangles.
    source : ndarray, shape (k,)
        The triangle of the m that each of them is a part of.
    """
    triangles = np.asarray(triangles, dtype=np.float64)
    lower = np.array(grid.origin)
    upper = lower + np.array(grid.shape) * grid.resolution
    lower_corner, upper_corner = triangles.min(axis=1), triangles.max(axis=1)
    outside = ((lower_corner > upper) | (upper_corner < lower)).any(axis=1)
    inside = ((lower_corner >= lower) & (upper_corner <= upper)).all(axis=1)
    pieces, source = [triangles[inside]], [np.flatnonzero(inside)]
    for m in np.flatnonzero(~inside & ~outside):
        polygon = _clip_polygon(triangles[m], lower, upper)
        if len(polygon) < 3:
            continue
        fan = [[polygon[0], polygon[k], polygon[k + 1]] for k in range(1, len(polygon) - 1)]
        pieces.append(np.array(fan))
        source.append(np.full(len(fan), m))
    return np.concatenate(pieces), np.concatenate(source)


def _clip_polygon(
    polygon: NDArray[np.float64], lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The part of a convex polygon (k, 3) inside a box (Sutherland and Hodgman 1974)."""
    for axis, sign in BOX_SIDES:
        limit = lower[axis] if sign > 0 else -upper[axis]
        height = sign * polygon[:, axis] - limit
        clipped = []
        for k, (point, h) in enumerate(zip(polygon, height, strict=True)):
            before, g = polygon[k - 1], height[k - 1]
            if (h >= 0) != (g >= 0):
                cut = before + (point - before) * (g / (g - h))
                cut[axis] = sign * limit
                clipped.append(cut)
            if h >= 0:
                clipped.append(point)
        polygon = np.array(clipped).reshape(-1, 3)
        if not len(polygon):
            break
    return polygon
