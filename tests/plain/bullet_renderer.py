"""PyBullet's own software renderer, as a reference for other depth images."""

import math

import numpy as np

from coopmap_env.simulation.physics.client import BulletClient, quaternion_from_matrix


class BulletRenderer:
    """Solids and mounts in a client of their own, rendered as their visual shapes.

    Parameters
    ----------
    solids : sequence of Solid
        Rendered as their triangles.
    mounts : sequence of Mount
        Rendered as their visual shapes.
    base_poses : sequence of Pose
        T_world_base of each mount.
    """

    def __init__(self, solids, mounts, base_poses):
        self.client = BulletClient()
        p, k = self.client.p, {"physicsClientId": self.client.id}
        self.bodies = [
            p.loadURDF(
                str(mount.urdf),
                pose.translation.tolist(),
                quaternion_from_matrix(pose.rotation),
                useFixedBase=True,
                **k,
            )
            for mount, pose in zip(mounts, base_poses, strict=True)
        ]
        for solid in solids:
            shape = p.createVisualShape(
                p.GEOM_MESH,
                vertices=solid.vertices.tolist(),
                indices=np.ravel(solid.faces).tolist(),
                **k,
            )
            p.createMultiBody(0, -1, shape, **k)

    def set_joints(self, robot, joints, values):
        """Set joints, by PyBullet's numbers, of one vehicle."""
        self.client.p.resetJointStatesMultiDof(
            self.bodies[robot], list(joints), [[v] for v in values], physicsClientId=self.client.id
        )

    def depth_image(self, camera, T_world_camera):
        """Depths along the optical axis, (height, width), metres; inf where there is nothing."""
        p, near = self.client.p, 0.02
        right = math.tan(camera.horizontal_field_of_view / 2)
        top = math.tan(camera.vertical_field_of_view / 2)
        far = 1.1 * camera.far
        view = np.eye(4)  # from the world to x right, y up, z backwards
        view[:3, :3] = T_world_camera.rotation[:, [1, 2, 0]].T * [[-1.0], [1.0], [-1.0]]
        view[:3, 3] = -view[:3, :3] @ T_world_camera.translation
        # TinyRenderer samples pixels at their lower left corners: half a pixel off their middles
        dx, dy = right / camera.width, top / camera.height
        edges = [(dx - right), (dx + right), (dy - top), (dy + top)]
        projection = p.computeProjectionMatrix(*(near * edge for edge in edges), near, far)
        image = p.getCameraImage(
            camera.width, camera.height, view.T.ravel().tolist(), projection, shadow=0,
            renderer=p.ER_TINY_RENDERER, physicsClientId=self.client.id,
        )  # fmt: skip
        buffer = np.reshape(image[3], (camera.height, camera.width)).astype(np.float64)
        depth = far * near / (far - (far - near) * buffer)
        return np.where(buffer < 1.0, depth, np.inf)

    def close(self):
        """Disconnect."""
        self.client.close()
