"""Solids: the closed or open surfaces that a field world is made of.

A solid has triangles (the truth that cameras see and maps are scored against) and convex parts,
which represent it in the physics.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.files import brief
from coopmap_env.core.linear_algebra import product

_CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
_BOX_FACES = np.array(
    [
        *([0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5]),  # -x, +x
        *([0, 4, 5], [0, 5, 1], [2, 3, 7], [2, 7, 6]),  # -y, +y
        *([0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]),  # -z, +z
    ]
)
"""Two triangles a side, anticlockwise as seen from outside."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A rigid object that does not move.

    Attributes
    ----------
    name : str
        Different for each solid of a world.
    vertices : (v, 3) float array
        Metres, world frame. Copied and read-only, as all arrays here.
    faces : (f, 3) int array
        Vertices of each triangle, anticlockwise as seen from outside.
    hulls : tuple of (k, 3) float arrays
        Points whose convex hulls represent the solid in the physics; empty: see `parts`.
    is_target : bool
        It is (a part of) what the robots are to map.
    is_ground : bool
        The robots stand on it: clearances and visibility ignore it.
    is_concave : bool
        No hulls describe it: the physics collides with its triangles.

    Raises
    ------
    ValueError
        With the value, if a field is not as described.
    """

    name: str
    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    hulls: tuple[NDArray[np.float64], ...] = ()
    is_target: bool = False
    is_ground: bool = False
    is_concave: bool = False

    def __post_init__(self) -> None:
        vertices = _checked_points(f"vertices of {self.name!r}", self.vertices, 3)
        try:
            faces = np.array(self.faces)
        except ValueError as error:  # rows of different lengths
            raise ValueError(
                f"faces of {self.name!r} must have shape (f, 3), not {brief(self.faces)}"
            ) from error
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise ValueError(f"faces of {self.name!r} must have shape (f, 3), not {faces.shape}")
        if faces.dtype.kind not in "iu":
            raise ValueError(f"faces of {self.name!r} must be integers, not {faces.dtype}")
        if faces.min() < 0 or faces.max() >= len(vertices):
            raise ValueError(
                f"faces of {self.name!r} must name vertices 0 to {len(vertices) - 1}, "
                f"not {faces.min()} to {faces.max()}"
            )
        faces = faces.astype(np.int64)
        faces.setflags(write=False)
        if self.is_target and self.is_ground:
            raise ValueError(f"{self.name!r} must not be target and ground at once")
        if self.is_concave and self.hulls:
            raise ValueError(f"{self.name!r} is concave and has {len(self.hulls)} hulls: one only")
        hulls = tuple(_checked_points(f"a hull of {self.name!r}", hull, 4) for hull in self.hulls)
        object.__setattr__(self, "vertices", vertices)
        object.__setattr__(self, "faces", faces)
        object.__setattr__(self, "hulls", hulls)

    @cached_property
    def triangles(self) -> NDArray[np.float64]:
        """Corners of the triangles, (f, 3, 3)."""
        triangles = self.vertices[self.faces]
        triangles.setflags(write=False)
        return triangles

    @property
    def parts(self) -> tuple[NDArray[np.float64], ...]:
        """Points of the convex parts: the hulls, or all vertices as one."""
        return self.hulls or (self.vertices,)

    @cached_property
    def bounds(self) -> NDArray[np.float64]:
        """Lower and upper corner of the box around it, (2, 3)."""
        used = self.triangles
        return freeze(np.stack([used.min(axis=(0, 1)), used.max(axis=(0, 1))]))


def _checked_points(what: str, values: ArrayLike, min_length: int) -> NDArray[np.float64]:
    """Read-only copy (n, 3) of at least `min_length` finite points."""
    try:
        points = np.array(values, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError(f"{what} must be numbers (n, 3), not {brief(values)}") from error
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < min_length:
        raise ValueError(f"{what} must have shape (n >= {min_length}, 3), not {points.shape}")
    if not np.isfinite(points).all():
        raise ValueError(f"{what} must be finite, not {points[~np.isfinite(points)][0]}")
    points.setflags(write=False)
    return points


def box_corners(
    size: ArrayLike, center: ArrayLike, rotation: NDArray[np.float64] | None = None
) -> NDArray[np.float64]:
    """Corners (8, 3) of a box: its sides (3,), its center (3,), R_world_box (3, 3)."""
    corners = _CORNERS * np.asarray(size, dtype=np.float64)
    return (corners if rotation is None else product(corners, rotation.T)) + np.asarray(center)


def solid_from_boxes(
    name: str,
    boxes: Iterable[NDArray[np.float64]],
    *,
    is_target: bool = False,
    is_ground: bool = False,
) -> Solid:
    """One solid of boxes, given by their corners as `box_corners` orders them; they may touch."""
    hulls = tuple(boxes)
    faces = np.concatenate([_BOX_FACES + 8 * k for k in range(len(hulls))])
    vertices = np.concatenate(hulls)
    return Solid(name, vertices, faces, hulls, is_target=is_target, is_ground=is_ground)


def solid_from_hull(name: str, points: ArrayLike, *, is_target: bool = False) -> Solid:
    """The convex hull of points (n, 3) as a solid.

    Raises
    ------
    ValueError
        If the points lie in one plane.
    """
    vertices, faces = convex_hull(points)
    return Solid(name, vertices, faces, (vertices,), is_target=is_target)


def convex_hull(points: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Vertices (v, 3) and outward faces (f, 3) of the convex hull of points (n, 3)."""
    from scipy.spatial import ConvexHull, QhullError  # a tenth of a second, not always needed

    points = np.asarray(points, dtype=np.float64)
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError) as error:
        reason = str(error).strip().splitlines()[0]
        raise ValueError(f"{len(points)} points span no convex hull: {reason}") from error
    kept, faces = np.unique(hull.simplices, return_inverse=True)
    vertices, faces = points[kept], faces.reshape(-1, 3)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = (np.cross(b - a, c - a) * hull.equations[:, :3]).sum(axis=1) < 0.0
    faces[inward] = faces[inward][:, ::-1]
    return vertices, faces


def ground_slab(lower: ArrayLike, upper: ArrayLike, thickness: float = 1.0) -> Solid:
    """Flat ground: a slab with its surface at z = 0 over a rectangle of x and y."""
    lower, upper = np.asarray(lower, dtype=np.float64)[:2], np.asarray(upper, dtype=np.float64)[:2]
    size, middle = upper - lower, (lower + upper) / 2
    slab = box_corners([*size, thickness], [*middle, -thickness / 2])
    return solid_from_boxes("ground", [slab], is_ground=True)
