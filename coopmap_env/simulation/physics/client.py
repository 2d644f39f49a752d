"""PyBullet: clients, shapes and vehicles in them, and its renderer.

This is the only file that imports PyBullet.
"""

from __future__ import annotations

import math
import weakref
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.geometry.transforms import Pose
from coopmap_env.robots.mount import Mount
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.scenes.field.solid import Solid


class BulletClient:
    """A connection to a physics engine in this process; closed by `close`, or when let go."""

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

    def create_shape(
        self, vertices: NDArray[np.float64], faces: Any = None, *, visual: bool = False
    ) -> int:
        """A shape: the convex hull of `vertices` (v, 3), or the triangles `faces` (f, 3) of them.

        PyBullet never lets go of the rows that it is given: they are lent to it, again and again.
        """
        rows = _vertex_rows(len(vertices))
        for row, vertex in zip(rows, vertices.tolist(), strict=True):
            row[:] = vertex
        make = self.p.createVisualShape if visual else self.p.createCollisionShape
        options: dict[str, Any] = {} if faces is None else {"indices": np.ravel(faces).tolist()}
        if faces is not None and not visual:
            options["flags"] = self.p.GEOM_FORCE_CONCAVE_TRIMESH
        return int(make(self.p.GEOM_MESH, vertices=rows, physicsClientId=self.id, **options))

    def load_mount(self, mount: Mount, T_world_base: Pose, *, visual: bool = False) -> int:
        """Load a vehicle, its base fixed; with its visual shapes only if it is to be `visual`."""
        p = self.p
        flags = p.URDF_USE_SELF_COLLISION | (0 if visual else p.URDF_IGNORE_VISUAL_SHAPES)
        number = p.loadURDF(
            str(mount.urdf),
            T_world_base.translation.tolist(),
            quaternion_from_matrix(T_world_base.rotation),
            useFixedBase=True,
            flags=flags,
            physicsClientId=self.id,
        )
        return int(number)

    def cast_rays(
        self, origins: NDArray[np.float64], ends: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Share of the way from `origins` (n, 3) to `ends` at which rays hit something; 1 if none.

        At most 16,384 rays a call, on one thread: a reference of other ray casters.
        """
        hits = self.p.rayTestBatch(
            origins.tolist(), ends.tolist(), numThreads=1, physicsClientId=self.id
        )
        return np.array([hit[2] for hit in hits])


@lru_cache(maxsize=256)
def _vertex_rows(n: int) -> list[list[float]]:
    """The same n rows for whoever asks."""
    return [[0.0, 0.0, 0.0] for _ in range(n)]


def quaternion_from_matrix(R: NDArray[np.float64]) -> list[float]:
    """[x, y, z, w] of a rotation matrix: its eigenvector form, without a case for large turns."""
    xx, xy, xz, yx, yy, yz, zx, zy, zz = R.ravel()
    K = np.array([
        [xx - yy - zz, 0.0, 0.0, 0.0],
        [yx + xy, yy - xx - zz, 0.0, 0.0],
        [zx + xz, zy + yz, zz - xx - yy, 0.0],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ])  # fmt: skip
    return np.linalg.eigh(K)[1][:, -1].tolist()


class BulletRenderer:
    """PyBullet's own software renderer, in a client of its own: a check of other depth images.

    Parameters
    ----------
    solids : sequence of Solid
        Seen as their triangles.
    mounts : sequence of Mount
        Seen as their visual shapes.
    base_poses : sequence of Pose
        T_world_base of each.
    """

    def __init__(
        self, solids: Sequence[Solid], mounts: Sequence[Mount], base_poses: Sequence[Pose]
    ) -> None:
        self.client = BulletClient()
        self.bodies = [
            self.client.load_mount(mount, pose, visual=True)
            for mount, pose in zip(mounts, base_poses, strict=True)
        ]
        for solid in solids:
            shape = self.client.create_shape(solid.vertices, solid.faces, visual=True)
            self.client.p.createMultiBody(0, -1, shape, physicsClientId=self.client.id)

    def set_joints(self, robot: int, joints: Sequence[int], values: Sequence[float]) -> None:
        """Set joints, by Bullet's numbers, of one vehicle."""
        self.client.p.resetJointStatesMultiDof(
            self.bodies[robot], list(joints), [[v] for v in values], physicsClientId=self.client.id
        )

    def depth_image(self, camera: DepthCamera, T_world_camera: Pose) -> NDArray[np.float64]:
        """Depths along the optical axis, (height, width), metres; inf where there is nothing."""
        p, near = self.client.p, 0.02
        right = math.tan(camera.horizontal_field_of_view / 2)
        top = math.tan(camera.vertical_field_of_view / 2)
        far = 1.1 * camera.far
        view = np.eye(4)  # from the world to x right, y up, z backwards
        view[:3, :3] = T_world_camera.rotation[:, [1, 2, 0]].T * [[-1.0], [1.0], [-1.0]]
        view[:3, 3] = -view[:3, :3] @ T_world_camera.translation
        # TinyRenderer looks through the left lower corners of pixels: half a pixel to their middles
        dx, dy = right / camera.width, top / camera.height
        projection = p.computeProjectionMatrix(
            (dx - right) * near,
            (dx + right) * near,
            (dy - top) * near,
            (dy + top) * near,
            near,
            far,
        )
        image = p.getCameraImage(
            camera.width, camera.height, view.T.ravel().tolist(), projection, shadow=0,
            renderer=p.ER_TINY_RENDERER, physicsClientId=self.client.id,
        )  # fmt: skip
        buffer = np.reshape(image[3], (camera.height, camera.width)).astype(np.float64)
        depth = far * near / (far - (far - near) * buffer)
        return np.where(buffer < 1.0, depth, np.inf)

    def close(self) -> None:
        """Disconnect."""
        self.client.close()
