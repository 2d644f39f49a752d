"""Triangles that rays are traced through, by Embree."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.extras import import_optional


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
        self._scene = _embree_scene(about_middle.astype(np.float32))

    def intersect(
        self,
        origins: NDArray[np.float32],
        directions: NDArray[np.float32],
        lengths: NDArray[np.float32],
    ) -> None:
        """Cut rays (n, 3), which begin relative to `center`, to where they first meet the mesh."""
        if len(lengths):
            self._scene.run(origins, directions, lengths, query="DISTANCE")

    def __reduce__(self) -> tuple[Any, ...]:
        return TracedMesh, (self.triangles,)


def _embree_scene(corners: NDArray[np.float32]) -> Any:
    """Embree's scene of triangles, its tree built by a first ray."""
    scene = import_optional("embreex.rtcore_scene", "field").EmbreeScene(robust=True)
    if len(corners):
        import_optional("embreex.mesh_construction", "field").TriangleMesh(scene, corners)
    ray = np.ones((1, 3), dtype=np.float32)
    scene.run(ray, ray, np.ones(1, dtype=np.float32), query="DISTANCE")
    return scene
