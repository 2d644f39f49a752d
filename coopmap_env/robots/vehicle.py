"""A vehicle: a mount at a base pose in the world, and the estimate of its camera's pose."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple
from coopmap_env.core.linear_algebra import length, product
from coopmap_env.geometry import Pose, Spheres, skew
from coopmap_env.robots.equilibrium import GRAVITY_VECTOR, Equilibrium
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.collision_spheres import CollisionSpheres
from coopmap_env.robots.kinematics.forward import mounted_frame_poses
from coopmap_env.robots.mount import Mount
from coopmap_env.robots.mount_library import make_mount


class PoseEstimate(NamedTuple):
    """Estimated pose of a robot's camera or base."""

    pose: Pose
    """T_world_camera."""
    covariance: NDArray[np.float64]
    """Shape (6, 6) of [translation, rotation vector] in the world frame, metres and radians."""


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A mount on a stationary vehicle.

    Poses of the camera follow from the joints: the robot does not measure its suspension. It
    predicts how far the body leans under the mount's weight (`equilibrium`; in the field
    environment ``motion_correction="kinematic"``), or assumes it at rest as at home ("encoders").
    Links and spheres are always where they are with the suspension at rest.
    """

    mount: Mount
    chain: Chain
    body: CollisionSpheres
    T_world_base: Pose
    base_covariance: NDArray[np.float64] | None = None
    """Shape (6, 6) of T_world_base, as of `PoseEstimate`; None if it is known exactly."""
    equilibrium: Equilibrium | None = None
    """Of the body on its springs, by the masses and the stiffness of the mount's description; None
    if the robot does not predict how far it leans."""

    @classmethod
    def from_mount(
        cls, mount: str | Mount, T_world_base: Pose, predicts_deflection: bool = False
    ) -> Vehicle:
        """A mount, by name or itself, on a vehicle at a pose in the world.

        Parameters
        ----------
        mount : str or Mount
        T_world_base : Pose
        predicts_deflection : bool, optional
            Whether camera poses contain the deflection of the suspension, if there is one.

        Raises
        ------
        ValueError
            If there is no such mount, or the pose is planar.
        """
        mount = make_mount(mount)
        chain = mount.chain()
        equilibrium = None
        if predicts_deflection and mount.suspension is not None:
            equilibrium = Equilibrium.from_mount(mount, _gravity(T_world_base))
        body = CollisionSpheres.from_chain(chain, mount.home)
        return cls(mount, chain, body, T_world_base, equilibrium=equilibrium)

    def __post_init__(self) -> None:
        if self.T_world_base.translation.shape != (3,):
            raise ValueError(f"a vehicle needs a 3-D base pose, got {self.T_world_base}")

    @property
    def home(self) -> NDArray[np.float64]:
        """Joint values (n,) at the start."""
        return np.array(self.mount.home)

    def camera_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """T_world_camera: R (k, 3, 3), t (k, 3); without k for a single q (n,)."""
        joints = self.chain.as_joint_values(q)
        R, t = self._camera_poses(np.atleast_2d(self._camera_joints(joints)))
        return (R, t) if joints.ndim == 2 else (R[0], t[0])

    def _camera_poses(
        self, joints: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """`camera_poses` from `_camera_joints` (k, m)."""
        R, t = mounted_frame_poses(self._mounted_camera, joints)
        return R[:, 0], t[:, 0]

    @cached_property
    def _mounted_camera(self) -> PlainTuple:
        """The camera's frame on the chain that `_camera_joints` belong to."""
        chain = self.chain if self.equilibrium is None else self._suspended_chain
        return chain.mounted(self.T_world_base, *chain.camera_frame)

    def _camera_joints(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (n,) or (k, n), after the deflections if these are predicted."""
        return joints if self.equilibrium is None else self._suspended_joints(joints)

    def camera_pose(self, q: ArrayLike) -> Pose:
        """T_world_camera at a single q (n,)."""
        R, t = self.camera_poses(q)
        return Pose(t, R)

    def link_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Poses of all links in the world: R (k, L, 3, 3), t (k, L, 3)."""
        R, t = self.chain.link_poses(q)
        return product(self.T_world_base.rotation, R), self.T_world_base.transform(t)

    def spheres(self, q: ArrayLike) -> Spheres:
        """Centers (k, s, 3) in the world frame and radii (s,) of the spheres that cover it."""
        return Spheres(self.T_world_base.transform(self.body.centers(q)), self.body.radii)

    @cached_property
    def workspace_sphere(self) -> tuple[NDArray[np.float64], float]:
        """A sphere that no moving collision sphere leaves: center (3,), world frame, and radius.

        It is centered on the first joint, and as large as all links stretched out.
        """
        tree, chain, body = self.chain.tree, self.chain, self.body
        farthest = np.maximum(np.abs(chain.lower), np.abs(chain.upper))
        slide = np.abs(tree.multiplier) * farthest[tree.variable] + np.abs(tree.offset)
        center = tree.translation[1]
        out = np.zeros(len(tree.parent))
        for b in range(1, len(out)):
            above = tree.parent[b]
            start = tree.translation[b] - (0.0 if above else center)
            out[b] = out[above] + length(start) + (slide[b] if tree.prismatic[b] else 0.0)
        spheres = (
            out[body.sphere_body_index] + np.linalg.norm(body.local_centers, axis=1) + body.radii
        )
        return self.T_world_base.transform(center), float(
            spheres[body.n_static_spheres :].max(initial=0.0)
        )

    @cached_property
    def _suspended_chain(self) -> Chain:
        """The chain with the suspension's joints first."""
        return self.mount.chain(with_suspension=True)

    def _suspended_joints(self, joints: NDArray[np.float64]) -> NDArray[np.float64]:
        """Joints (n,) or (k, n) with heave, roll and pitch before them, as predicted."""
        if self.equilibrium is None:
            return np.concatenate([np.zeros((*joints.shape[:-1], 3)), joints], axis=-1)
        full = self.equilibrium.rest_configurations(np.atleast_2d(joints))
        return full if joints.ndim == 2 else full[0]

    def camera_deflection(self, q: ArrayLike) -> float:
        """Metres by which the suspension is predicted to move the camera at q (n,)."""
        if self.equilibrium is None:
            return 0.0
        joints = self.chain.as_joint_values(q)
        rest = self.chain.camera_poses(joints)[1]
        return length(self._suspended_chain.camera_poses(self._suspended_joints(joints))[1] - rest)

    def with_base_pose(
        self, T_world_base: Pose, covariance: NDArray[np.float64] | None = None
    ) -> Vehicle:
        """The same vehicle at another base pose."""
        equilibrium = self.equilibrium
        if equilibrium is not None:
            equilibrium = equilibrium.with_gravity(_gravity(T_world_base))
        return replace(
            self, T_world_base=T_world_base, base_covariance=covariance, equilibrium=equilibrium
        )

    def with_compliance(self, compliance: NDArray[np.float64]) -> Vehicle:
        """The same vehicle on springs of another `Equilibrium.compliance` (2,), if it has any."""
        if self.equilibrium is None:
            return self
        return replace(self, equilibrium=self.equilibrium.with_compliance(compliance))

    def camera_estimate(self, q: ArrayLike) -> PoseEstimate:
        """The camera's pose by the encoders' readings, with its uncertainty to first order.

        The covariance is `per_scan_covariance` plus that of the errors which persist from scan to
        scan: J S J^T with the variances S of the joints' calibration, that of the springs'
        compliance where their deflection is predicted, and that of the base if it is not known
        exactly.

        Parameters
        ----------
        q : array_like, shape (n,)
            Encoder readings.
        """
        q = self.chain.as_joint_values(q)
        joints = self._camera_joints(q)
        R, t = self._camera_poses(joints[None])
        pose = Pose(t[0], R[0])
        full = None
        if self.mount.suspension is not None:
            is_suspended = self.equilibrium is not None
            full = self._suspended_jacobian(joints if is_suspended else self._suspended_joints(q))
        predicted = None if self.equilibrium is None else full
        J = self.joint_jacobian(q) if predicted is None else predicted[:, 5:]
        persistent_covariance = product(J * np.square(self.mount.calibration_error), J.T)
        if predicted is not None:
            C = predicted[:, 3:5] * self.compliance_std
            persistent_covariance += product(C, C.T)
        if self.base_covariance is not None:
            B = self.base_jacobian(pose)
            persistent_covariance += product(product(B, self.base_covariance), B.T)
        per_scan = self._per_scan_covariance(J if full is None else full)
        return PoseEstimate(pose, per_scan + persistent_covariance)

    def per_scan_covariance(self, q: ArrayLike) -> NDArray[np.float64]:
        """Covariance (6, 6) of the camera's pose by errors that are independent in each scan.

        J S J^T with the camera's Jacobian J, world frame. S has the variances of the encoders'
        noise, and those assumed for heave, roll and pitch of the body.
        """
        q = self.chain.as_joint_values(q)
        has_suspension = self.mount.suspension is not None
        return self._per_scan_covariance(
            self._jacobian(q) if has_suspension else self.joint_jacobian(q)
        )

    def _per_scan_covariance(self, J: NDArray[np.float64]) -> NDArray[np.float64]:
        """`per_scan_covariance` from `_jacobian`, or `joint_jacobian` without a suspension."""
        if self.equilibrium is not None:
            J = np.concatenate([J[:, :3], J[:, 5:]], axis=1)  # compliances persist
        return product(J * self._per_scan_variances, J.T)

    def joint_jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, n) of the camera [translation; rotation vector] with respect to its joints.

        World frame. A joint that moves changes the load of the springs, if that is predicted.
        """
        if self.equilibrium is None:
            return self._rotated_to_world(self.chain.jacobian(q))
        return self._jacobian(q)[:, 5:]

    def compliance_jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, 2) of the camera with respect to `Equilibrium.compliance`, world frame.

        Raises
        ------
        ValueError
            If the deflection is not predicted.
        """
        if self.equilibrium is None:
            raise ValueError("the vehicle does not predict its deflection")
        return self._jacobian(q)[:, 3:5]

    @property
    def compliance_std(self) -> float:
        """Standard deviation of `Equilibrium.compliance`; 0 without a suspension."""
        return 0.0 if self.mount.suspension is None else self.mount.suspension.compliance_std

    def base_jacobian(self, camera: Pose) -> NDArray[np.float64]:
        """Jacobian (6, 6) of T_world_camera with respect to T_world_base, as displacements."""
        J = np.eye(6)
        J[:3, 3:] = -skew(camera.translation - self.T_world_base.translation)
        return J

    def _jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, m) of the camera, world frame.

        By heave, roll and pitch, by the two compliances if the deflection is predicted, by the
        joints.
        """
        return self._suspended_jacobian(self._suspended_joints(self.chain.as_joint_values(q)))

    def _suspended_jacobian(self, full: NDArray[np.float64]) -> NDArray[np.float64]:
        """`_jacobian` at joints (3 + n,) with the deflections before them."""
        J = self._rotated_to_world(self._suspended_chain.jacobian(full))
        if self.equilibrium is None:
            return J
        by_load = product(J[:, 1:3], self.equilibrium.jacobian(full))
        return np.concatenate([J[:, :3], by_load[:, :2], J[:, 3:] + by_load[:, 2:]], axis=1)

    def _rotated_to_world(self, J: NDArray[np.float64]) -> NDArray[np.float64]:
        """Both halves of a Jacobian (6, k), translation and rotation vector, in the world frame."""
        return product(self.T_world_base.rotation, J.reshape(2, 3, -1)).reshape(6, -1)

    @cached_property
    def _per_scan_variances(self) -> NDArray[np.float64]:
        """Joint variances of `_suspended_chain`, or of the chain if there is no suspension."""
        mount = self.mount
        body: tuple[float, ...] = ()
        if mount.suspension is not None:
            predicted = self.equilibrium is not None
            body = mount.suspension.predicted_std if predicted else mount.suspension.std
        return np.concatenate([np.square(body), np.square(mount.encoder_noise)])


def _gravity(T_world_base: Pose) -> NDArray[np.float64]:
    """Gravity (3,) in the frame of a base, m/s^2."""
    return product(T_world_base.rotation.T, GRAVITY_VECTOR)
