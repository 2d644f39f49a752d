"""PyBullet: clients, and shapes and vehicles in them.

This is the only file that imports PyBullet.
"""

from __future__ import annotations

import weakref
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry import Pose
from coopmap_env.robots import Mount


class BulletClient:
    """A connection to a physics engine in this process; `close` or garbage collection ends it."""

    def __init__(self) -> None:
        self.p = import_optional("pybullet", "field")
        self._id = self.p.connect(self.p.DIRECT)
        if self._id < 0:
            raise RuntimeError("PyBullet allows no further client: close other worlds first")
        self._closed = weakref.finalize(self, self.p.disconnect, self._id)

    @property
    def id(self) -> int:
        """PyBullet's number of the client.

        Raises
        ------
        RuntimeError
            If it is closed.
        """
        if not self._closed.alive:
            raise RuntimeError("this physics world is closed; make another one")
        return int(self._id)

    def close(self) -> None:
        """Disconnect; doing so twice does no harm."""
        self._closed()

    def create_shape(self, vertices: NDArray[np.float64], faces: Any = None) -> int:
        """Number of a collision shape: the convex hull of `vertices` (v, 3), or their triangles.

        `faces` (f, 3) are the triangles. PyBullet never frees the rows that it is given, so the
        same rows serve all shapes of as many vertices.
        """
        rows = _vertex_rows(len(vertices))
        for row, vertex in zip(rows, vertices.tolist(), strict=True):
            row[:] = vertex
        options: dict[str, Any] = {}
        if faces is not None:
            options["indices"] = np.ravel(faces).tolist()
            options["flags"] = self.p.GEOM_FORCE_CONCAVE_TRIMESH
        return int(
            self.p.createCollisionShape(
                self.p.GEOM_MESH, vertices=rows, physicsClientId=self.id, **options
            )
        )

    def load_mount(self, mount: Mount, T_world_base: Pose) -> int:
        """Load a vehicle without its visual shapes, its base fixed; PyBullet's number of it."""
        p = self.p
        number = p.loadURDF(
            str(mount.urdf),
            T_world_base.translation.tolist(),
            quaternion_from_matrix(T_world_base.rotation),
            useFixedBase=True,
            flags=p.URDF_USE_SELF_COLLISION | p.URDF_IGNORE_VISUAL_SHAPES,
            physicsClientId=self.id,
        )
        return int(number)

    def cast_rays(
        self, origins: NDArray[np.float64], ends: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Fractions (n,) of the segments from `origins` to `ends` (n, 3) at which rays hit; else 1.

        At most 16,384 rays a call, on one thread: a reference for other ray casters.
        """
        hits = self.p.rayTestBatch(
            origins.tolist(), ends.tolist(), numThreads=1, physicsClientId=self.id
        )
        return np.array([hit[2] for hit in hits])


@lru_cache(maxsize=256)
def _vertex_rows(n: int) -> list[list[float]]:
    """Rows of n vertices; the same ones at every call."""
    return [[0.0, 0.0, 0.0] for _ in range(n)]


def quaternion_from_matrix(R: NDArray[np.float64]) -> list[float]:
    """[x, y, z, w] of a rotation matrix, by an eigenvector: no special cases (Bar-Itzhack 2000)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R.ravel()
    K = np.array([
        [xx - yy - zz, 0.0, 0.0, 0.0],
        [yx + xy, yy - xx - zz, 0.0, 0.0],
        [zx + xz, zy + yz, zz - xx - yy, 0.0],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ])  # fmt: skip
    return np.linalg.eigh(K)[1][:, -1].tolist()
