"""PyBullet: clients, and shapes and vehicles in them.

This is the only file that imports PyBullet.
"""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.linear_algebra import eigh
from coopmap_env.core.quiet import native_stderr_muted
from coopmap_env.geometry import Pose
from coopmap_env.robots import Mount


class BulletClient:
    """A connection to a physics engine in this process; `close` or garbage collection ends it."""

    def __init__(self) -> None:
        with native_stderr_muted():  # it prints when it was built
            self.p = import_optional("pybullet", "field")
        self._id = self.p.connect(self.p.DIRECT)
        if self._id < 0:
            raise RuntimeError("PyBullet allows no further client: close other worlds first")
        self._closed = weakref.finalize(self, self.p.disconnect, self._id)
        # or a file that has changed since another client loaded it would be the old one
        self.p.setPhysicsEngineParameter(enableFileCaching=0, physicsClientId=self._id)

    @property
    def id(self) -> int:
        """PyBullet's number of the client.

        Raises
        ------
        RuntimeError
            If it is closed.
        """
        self.check_open()
        return int(self._id)

    def check_open(self) -> None:
        """Raise RuntimeError if the client is closed."""
        if not self._closed.alive:
            raise RuntimeError("this physics world is closed; make another one")

    def close(self) -> None:
        """Disconnect; doing so twice does no harm."""
        self._closed()

    def create_shape(self, vertices: NDArray[np.float64], faces: Any = None) -> int:
        """Number of a collision shape: the convex hull of `vertices` (v, 3), or their triangles.

        `faces` (f, 3) are the triangles. PyBullet never frees the rows that it is given, so the
        same rows serve all shapes, one after another.
        """
        options: dict[str, Any] = {}
        if faces is not None:
            options["indices"] = np.ravel(faces).tolist()
            options["flags"] = self.p.GEOM_FORCE_CONCAVE_TRIMESH
        with _vertex_rows.holding(vertices) as rows:
            return int(
                self.p.createCollisionShape(
                    self.p.GEOM_MESH, vertices=rows, physicsClientId=self.id, **options
                )
            )

    def load_mount(self, mount: Mount, T_world_base: Pose) -> int:
        """Load a vehicle without its visual shapes, its base fixed; PyBullet's number of it.

        Raises
        ------
        ValueError
            If PyBullet cannot load it; the message names the URDF.
        """
        p = self.p
        try:
            number = p.loadURDF(
                str(mount.urdf_for_physics()),
                T_world_base.translation.tolist(),
                quaternion_from_matrix(T_world_base.rotation),
                useFixedBase=True,
                flags=p.URDF_USE_SELF_COLLISION | p.URDF_IGNORE_VISUAL_SHAPES,
                physicsClientId=self.id,
            )
        except p.error as error:
            raise ValueError(f"PyBullet cannot load {mount.urdf}: {error}") from error
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


class _VertexRows:
    """The rows of vertices that PyBullet is given: as many as the largest shape has, in all.

    One thread at a time writes them and lets PyBullet read them.
    """

    def __init__(self) -> None:
        self._rows: list[list[float]] = []
        self._lock = threading.Lock()

    def renew_lock(self) -> None:
        """Drop a lock that may be held by a thread of another process."""
        self._lock = threading.Lock()

    @contextmanager
    def holding(self, vertices: NDArray[np.float64]) -> Iterator[list[list[float]]]:
        """Rows that hold `vertices` (v, 3) until the block ends."""
        values = vertices.tolist()
        with self._lock:
            self._rows += [[0.0, 0.0, 0.0] for _ in range(len(values) - len(self._rows))]
            rows = self._rows[: len(values)]
            for row, value in zip(rows, values, strict=True):
                row[:] = value
            yield rows


_vertex_rows = _VertexRows()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_vertex_rows.renew_lock)


def quaternion_from_matrix(R: NDArray[np.float64]) -> list[float]:
    """[x, y, z, w] of a rotation matrix, by an eigenvector: no special cases (Bar-Itzhack 2000)."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R.ravel()
    xy, xz, yz, x, y, z = yx + xy, zx + xz, zy + yz, zy - yz, xz - zx, yx - xy
    K = np.array([
        [xx - yy - zz, xy, xz, x],
        [xy, yy - xx - zz, yz, y],
        [xz, yz, zz - xx - yy, z],
        [x, y, z, xx + yy + zz],
    ])  # fmt: skip
    return eigh(K)[1][:, -1].tolist()
