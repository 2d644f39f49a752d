"""A vehicle: a mount at a base pose in the world, and the estimate of its camera's pose."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple
from coopmap_env.core.linear_algebra import length, product, total
from coopmap_env.geometry import Pose, Spheres
from coopmap_env.robots._camera_kernels import (
    CameraJacobians,
    CameraModel,
    CameraUncertainty,
    add_per_scan_covariance,
    camera_deflection,
    camera_jacobians,
    camera_joints,
    estimate_camera,
    write_base_jacobian,
)
from coopmap_env.robots.equilibrium import GRAVITY_VECTOR, Equilibrium
from coopmap_env.robots.kinematics.chain import Chain
from coopmap_env.robots.kinematics.collision_spheres import CollisionSpheres
from coopmap_env.robots.kinematics.forward import mounted_frame_poses, mounted_point_positions
from coopmap_env.robots.mount import Mount
from coopmap_env.robots.mount_library import make_mount
from coopmap_env.robots.suspension import SUSPENSION_JOINTS


class PoseEstimate(NamedTuple):
    """Estimated pose of a robot's camera or base."""

    pose: Pose
    """T_world_camera."""
    covariance: NDArray[np.float64]
    """Shape (6, 6) of [translation, rotation vector] in the world frame, metres and radians."""

    @property
    def position_std(self) -> float:
        """Standard deviation of the position, of the variances along all axes together, metres."""
        return math.sqrt(total(self.covariance.diagonal()[:3].tolist()))


@dataclass(frozen=True, eq=False)
class Vehicle:
    """A mount on a stationary vehicle.

    Poses of the camera follow from the joints: the robot does not measure its suspension. It
    predicts how far the body leans under the mount's weight (`equilibrium`; in the field
    environment ``motion_correction="kinematic"``), or assumes it at rest as at home ("encoders").
    Links and spheres are always where they are with the suspension at rest.

    Raises
    ------
    ValueError
        If the base pose is planar, its covariance has another shape, or a mount without suspension
        has an equilibrium.
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
        if self.equilibrium is not None and self.mount.suspension is None:
            raise ValueError(f"the mount {self.mount.name!r} has no suspension to be predicted")
        if self.base_covariance is not None and np.shape(self.base_covariance) != (6, 6):
            raise ValueError(f"base_covariance must be (6, 6), got {self.base_covariance}")

    @property
    def home(self) -> NDArray[np.float64]:
        """Joint values (n,) at the start."""
        return np.array(self.mount.home)

    def camera_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """T_world_camera: R (k, 3, 3), t (k, 3); without k for a single q (n,)."""
        joints = self.chain.as_joint_values(q)
        on_chain = camera_joints(self._camera_model, np.atleast_2d(joints))
        R, t = mounted_frame_poses(self._camera_model[0], on_chain)
        return (R[:, 0], t[:, 0]) if joints.ndim == 2 else (R[0, 0], t[0, 0])

    def camera_pose(self, q: ArrayLike) -> Pose:
        """T_world_camera at a single q (n,)."""
        R, t = self.camera_poses(q)
        return Pose(t, R)

    def link_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Poses of all links in the world: R (k, L, 3, 3), t (k, L, 3)."""
        R, t = self.chain.link_poses(q)
        return product(self.T_world_base.rotation, R), self.T_world_base.transform(t)

    def spheres(self, q: ArrayLike) -> Spheres:
        """Centers (k, s, 3) in the world frame and radii (s,) of the spheres that cover it.

        Without k for a single q (n,).
        """
        joints = self.chain.as_joint_values(q)
        centers = mounted_point_positions(self._mounted_spheres, np.atleast_2d(joints))
        return Spheres(centers if joints.ndim == 2 else centers[0], self.body.radii)

    @cached_property
    def _mounted_spheres(self) -> PlainTuple:
        """The centers of the spheres as plain `MountedPoints`."""
        tree, body, base = self.chain.tree, self.body, self.T_world_base.arrays
        return (tuple(tree), body.sphere_body_index, body.local_centers, *base)

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
    def _camera_model(self) -> PlainTuple:
        """A plain `CameraModel`."""
        is_suspended, equilibrium = self.mount.suspension is not None, self.equilibrium
        chain = self.mount.chain(with_suspension=True) if is_suspended else self.chain
        springs = (
            Equilibrium.plain_without_springs(chain.tree)
            if equilibrium is None
            else equilibrium.plain
        )
        return tuple(
            CameraModel(
                chain.mounted(self.T_world_base, *chain.camera_frame),
                *springs,
                len(SUSPENSION_JOINTS) if is_suspended else 0,
                equilibrium is not None,
            )
        )

    @cached_property
    def _camera_uncertainty(self) -> PlainTuple:
        """A plain `CameraUncertainty`."""
        mount, covariance = self.mount, self.base_covariance
        body: tuple[float, ...] = ()
        if mount.suspension is not None:
            is_predicted = self.equilibrium is not None
            body = mount.suspension.predicted_std if is_predicted else mount.suspension.std
        return tuple(
            CameraUncertainty(
                np.concatenate([np.square(body), np.square(mount.encoder_noise)]),
                np.square(mount.calibration_error),
                self.compliance_std,
                np.array(np.empty((0, 0)) if covariance is None else covariance, np.float64),
            )
        )

    def _one_pose(self, q: ArrayLike) -> NDArray[np.float64]:
        """Joint values (n,) of one pose.

        Raises
        ------
        ValueError
            If they are another number, or not finite.
        """
        joints = self.chain.as_joint_values(q)
        if joints.ndim != 1:
            raise ValueError(f"one pose is needed, got joint values of shape {joints.shape}")
        return joints

    def camera_deflection(self, q: ArrayLike) -> float:
        """Metres by which the suspension is predicted to move the camera at q (n,)."""
        return camera_deflection(self._camera_model, self._one_pose(q))

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
        R, t, covariance = estimate_camera(
            self._camera_model, self._camera_uncertainty, self._one_pose(q)
        )
        return PoseEstimate(Pose(t, R), covariance)

    def per_scan_covariance(self, q: ArrayLike) -> NDArray[np.float64]:
        """Covariance (6, 6) of the camera's pose by errors that are independent in each scan.

        J S J^T with the camera's Jacobian J, world frame. S has the variances of the encoders'
        noise, and those assumed for heave, roll and pitch of the body.
        """
        covariance = np.zeros((6, 6))
        add_per_scan_covariance(self._camera_uncertainty, self._jacobians(q), covariance)
        return covariance

    def joint_jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, n) of the camera [translation; rotation vector] with respect to its joints.

        World frame. A joint that moves changes the load of the springs, if that is predicted.
        """
        return self._jacobians(q).by_joints[:, -self.chain.n_joints :]

    def compliance_jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, 2) of the camera with respect to `Equilibrium.compliance`, world frame.

        Raises
        ------
        ValueError
            If the deflection is not predicted.
        """
        if self.equilibrium is None:
            raise ValueError("the vehicle does not predict its deflection")
        return self._jacobians(q).by_compliance

    def _jacobians(self, q: ArrayLike) -> CameraJacobians:
        """Derivatives of the camera's pose at q (n,)."""
        joints = camera_joints(self._camera_model, self._one_pose(q)[None])[0]
        return camera_jacobians(self._camera_model, joints)

    @property
    def compliance_std(self) -> float:
        """Standard deviation of `Equilibrium.compliance`; 0 without a suspension."""
        return 0.0 if self.mount.suspension is None else self.mount.suspension.compliance_std

    def base_jacobian(self, camera: Pose) -> NDArray[np.float64]:
        """Jacobian (6, 6) of T_world_camera with respect to T_world_base, as displacements."""
        J = np.eye(6)
        position = camera.spatial_arrays.translation
        write_base_jacobian(position, self.T_world_base.arrays.translation, J)
        return J


def _gravity(T_world_base: Pose) -> NDArray[np.float64]:
    """Gravity (3,) in the frame of a base, m/s^2."""
    return product(T_world_base.rotation.T, GRAVITY_VECTOR)
