"""Triangles that rays are traced through, by Embree."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.kernels import kernel


class TracedMesh:
    """Triangles that rays can be traced through; built once, used by any number of renderers.

    Both sides of a triangle are seen. Rays do not slip through between neighbouring triangles.

    Parameters
    ----------
    triangles : array_like, shape (m, 3, 3)
        Corners of each triangle, metres. No triangles are an empty mesh.

    Raises
    ------
    ValueError
        If the shape is another one, or a corner is not finite.
    ImportError
        If the extra "field" is not installed.
    """

    def __init__(self, triangles: ArrayLike) -> None:
        corners = np.array(triangles, dtype=np.float64)
        if corners.ndim != 3 or corners.shape[1:] != (3, 3):
            raise ValueError(f"triangles must be (m, 3, 3), got {corners.shape}")
        if not np.isfinite(corners).all():
            bad = int(np.flatnonzero(~np.isfinite(corners).all(axis=(1, 2)))[0])
            raise ValueError(f"triangle {bad} is not finite: {corners[bad].tolist()}")
        corners.flags.writeable = False
        self.triangles: NDArray[np.float64] = corners
        lower, upper = np.zeros(3), np.zeros(3)
        if len(corners):
            lower, upper = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        self.center: NDArray[np.float64] = (lower + upper) / 2
        self.half_size: NDArray[np.float64] = (upper - lower) / 2
        # traced about its own middle, where single precision is best
        about_middle = corners - self.center
        self.radius = float(np.linalg.norm(about_middle, axis=-1).max(initial=0.0))
        rounded = about_middle.astype(np.float32)
        self._scene = _embree_scene(rounded)
        self._corners = rounded.astype(np.float64)

    def intersect(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        lengths: NDArray[np.float32],
    ) -> None:
        """Cut rays (n, 3), which begin relative to `center`, to where they first meet the mesh."""
        if len(lengths):
            ids = self._scene.run(origins, directions, lengths, query="INTERSECT")
            cut_rays(self._corners, ids, origins, directions, lengths)

    def __reduce__(self) -> tuple[Any, ...]:
        return TracedMesh, (self.triangles,)


@kernel
def cut_rays(
    corners: NDArray[np.float64],
    ids: NDArray[np.int32],
    origins: NDArray[np.float32],
    directions: NDArray[np.float32],
    lengths: NDArray[np.float32],
) -> None:
    """Cut each ray (n, 3) where it meets the plane of the triangle that it hits; -1 hits none.

    Embree computes this distance as well, with the vector instructions of the processor that it
    runs on: in the last bit, they disagree. Which triangle is hit, they agree about, but for rays
    within about 1e-7 of an edge.
    """
    for k in range(len(ids)):
        if ids[k] < 0:
            continue
        n = np.uint64(ids[k])
        dx, dy, dz = float(directions[k, 0]), float(directions[k, 1]), float(directions[k, 2])
        ox, oy, oz = float(origins[k, 0]), float(origins[k, 1]), float(origins[k, 2])
        ax, ay, az = corners[n, 0, 0], corners[n, 0, 1], corners[n, 0, 2]
        bx, by, bz = corners[n, 1, 0], corners[n, 1, 1], corners[n, 1, 2]
        cx, cy, cz = corners[n, 2, 0], corners[n, 2, 1], corners[n, 2, 2]
        to_a = dx * (ax - ox) + dy * (ay - oy) + dz * (az - oz)
        to_b = dx * (bx - ox) + dy * (by - oy) + dz * (bz - oz)
        to_c = dx * (cx - ox) + dy * (cy - oy) + dz * (cz - oz)
        nearest, farthest = min(to_a, to_b, to_c), max(to_a, to_b, to_c)
        ex, ey, ez = bx - ax, by - ay, bz - az
        fx, fy, fz = cx - ax, cy - ay, cz - az
        nx, ny, nz = ey * fz - ez * fy, ez * fx - ex * fz, ex * fy - ey * fx
        slope = nx * dx + ny * dy + nz * dz
        distance = nearest
        if slope != 0.0:
            distance = (nx * (ax - ox) + ny * (ay - oy) + nz * (az - oz)) / slope
        # a ray along a triangle meets it nowhere in particular: stay between its corners
        distance = max(min(max(distance, nearest), farthest), 0.0)
        lengths[k] = min(lengths[k], distance)


def _embree_scene(corners: NDArray[np.float32]) -> Any:
    """Embree's scene of triangles, its tree built by a first ray."""
    scene = import_optional("embreex.rtcore_scene", "field").EmbreeScene(robust=True)
    if len(corners):
        import_optional("embreex.mesh_construction", "field").TriangleMesh(scene, corners)
    ray = np.ones((1, 3), dtype=np.float32)
    scene.run(ray, ray, np.ones(1, dtype=np.float32), query="DISTANCE")
    return scene
