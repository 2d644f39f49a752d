"""Joint Gaussian over the camera poses, base poses, encoder offsets and springs of a team.

Surfaces that two scans have measured tie their camera poses together, so their errors are
correlated. To treat them as independent would count the same information again and again. The
state is a displacement of each scan's camera and, for each robot, what all of its scans have in
common: a displacement of its base, the constant offsets of its encoders and, if it predicts its
deflection, the errors of the compliance of its springs. Prediction adds a scan by the mount's
kinematics and the equilibrium of its springs; an update conditions the whole state on measured
displacements (a Kalman filter over delayed states: Eustice, Singh and Leonard 2006). The base pose
follows from camera poses and kinematics in the same state.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import product, solve
from coopmap_env.geometry import Pose, apply_displacement
from coopmap_env.robots import PoseEstimate, Vehicle

Array = NDArray[np.float64]

MIN_VARIANCE = 1e-9
"""Metres and radians, squared, added to a prediction, so that covariances stay definite."""
COMPLIANCE_BOUNDS = (0.2, 5.0)
"""Of springs, as a multiple of what is described: the state never leaves them. The equation is
linear, and a bad measurement could make a stiffness negative; `FieldSettings.max_stiffness_error`
allows no true spring outside of them."""


class PoseState:
    """Bases, encoder offsets, springs and camera poses of a team, with their joint covariance.

    Parameters
    ----------
    vehicles : sequence of Vehicle
        One for each robot, at its estimated base pose.
    """

    def __init__(self, vehicles: tuple[Vehicle, ...]) -> None:
        self.vehicles = list(vehicles)
        sizes = [6 + vehicle.chain.n_joints + _n_springs(vehicle) for vehicle in vehicles]
        self._starts = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int64)
        self._n_robot_state = int(self._starts[-1])
        self.robot_state = np.zeros(self._n_robot_state)
        """Per robot: displacement of its base (6), offsets of its encoders (n), errors of the
        relative compliance of roll and pitch (2, or none)."""
        self.covariance = np.zeros((self._n_robot_state, self._n_robot_state))
        self.cameras: list[Pose] = []
        """T_world_camera of each scan."""
        self._spring_indices = np.concatenate([
            np.arange(end - _n_springs(vehicle), end)
            for vehicle, end in zip(vehicles, self._starts[1:], strict=True)
        ])  # fmt: skip
        for robot, vehicle in enumerate(vehicles):
            at = np.arange(self._starts[robot] + 6, self._starts[robot + 1])
            springs = np.full(_n_springs(vehicle), vehicle.compliance_std)
            std = np.concatenate([vehicle.mount.calibration_error, springs])
            self.covariance[at, at] = np.square(std)

    def __len__(self) -> int:
        return len(self.cameras)

    def camera_slice(self, camera_index: int) -> slice:
        """Position of a camera's displacement in the state."""
        start = self._n_robot_state + 6 * camera_index
        return slice(start, start + 6)

    def set_base(self, robot: int, base: PoseEstimate) -> None:
        """Set the estimate of a robot's T_world_base; the robot has no cameras in the state yet."""
        self.vehicles[robot] = self.vehicles[robot].with_base_pose(base.pose)
        at = slice(self._starts[robot], self._starts[robot] + 6)
        self.robot_state[at] = 0.0
        self.covariance[at] = 0.0
        self.covariance[:, at] = 0.0
        self.covariance[at, at] = base.covariance

    def base(self, robot: int) -> PoseEstimate:
        """T_world_base by all measurements, with its covariance."""
        at = slice(self._starts[robot], self._starts[robot] + 6)
        pose = apply_displacement(self.vehicles[robot].T_world_base, self.robot_state[at])
        return PoseEstimate(pose, self.covariance[at, at])

    def estimate(self, camera_index: int) -> PoseEstimate:
        """T_world_camera of a scan, with its covariance."""
        at = self.camera_slice(camera_index)
        return PoseEstimate(self.cameras[camera_index], self.covariance[at, at])

    def predict(self, robot: int, reading: Array) -> PoseEstimate:
        """T_world_camera by encoder readings (n,) and the estimated base and offsets."""
        pose, _, covariance = self._prediction(robot, reading)
        return PoseEstimate(pose, covariance)

    def add(self, robot: int, reading: Array) -> int:
        """Add a camera to the state as predicted by encoder readings (n,); its index."""
        pose, cross_covariance, covariance = self._prediction(robot, reading)
        n = len(self.covariance)
        P = np.empty((n + 6, n + 6))
        P[:n, :n] = self.covariance
        P[n:, :n] = cross_covariance
        P[:n, n:] = P[n:, :n].T
        P[n:, n:] = covariance
        self.covariance = P
        self.cameras.append(pose)
        return len(self.cameras) - 1

    def state_indices(self, camera_indices: Sequence[int]) -> NDArray[np.int64]:
        """Positions (6 k,) of the displacements of k cameras in the state."""
        starts = self._n_robot_state + 6 * np.asarray(camera_indices, dtype=np.int64)
        return (starts[:, None] + np.arange(6)).ravel()

    def posterior_displacement(self, state_indices: NDArray[np.int64], A: Array, b: Array) -> Array:
        """Displacement (c,) of a part of the state by a measurement; the state stays as it is.

        The measurement has the likelihood exp(-x^T A x / 2 + b^T x) of x = state[state_indices],
        with A (c, c) and b (c,); A may be singular.
        """
        P = self.covariance[np.ix_(state_indices, state_indices)]
        return solve(np.eye(len(b)) + product(P, A), product(P, b))

    def update(self, state_indices: NDArray[np.int64], A: Array, b: Array) -> None:
        """Condition the whole state on a measurement, see `posterior_displacement`."""
        PH = self.covariance[:, state_indices]
        gain = solve(np.eye(len(b)) + product(A, PH[state_indices]), np.column_stack([A, b]))
        x = product(PH, gain[:, -1])
        P = self.covariance - product(product(PH, gain[:, :-1]), PH.T)
        self.covariance = 0.5 * (P + P.T)
        self.robot_state = self.robot_state + x[: self._n_robot_state]
        low, high = COMPLIANCE_BOUNDS
        springs = self.robot_state[self._spring_indices]
        self.robot_state[self._spring_indices] = springs.clip(low - 1.0, high - 1.0)
        displacements = x[self._n_robot_state :].reshape(-1, 6)
        self.cameras = [
            apply_displacement(p, d) for p, d in zip(self.cameras, displacements, strict=True)
        ]

    def remove_camera(self, camera_index: int) -> None:
        """Marginalise a camera out of the state; later ones move up by one index."""
        at = self.camera_slice(camera_index)
        kept = np.r_[0 : at.start, at.stop : len(self.covariance)]
        self.covariance = self.covariance[np.ix_(kept, kept)]
        del self.cameras[camera_index]

    def _prediction(self, robot: int, reading: Array) -> tuple[Pose, Array, Array]:
        """T_world_camera, its covariance (6, N) with the state, and its own (6, 6)."""
        vehicle, start, stop = self.vehicles[robot], self._starts[robot], self._starts[robot + 1]
        n = len(reading)
        base, offsets, springs = np.split(self.robot_state[start:stop], [6, 6 + n])
        joints = reading - offsets
        if base.any():
            vehicle = vehicle.with_base_pose(apply_displacement(vehicle.T_world_base, base))
        if springs.any():
            vehicle = vehicle.with_compliance(1.0 + springs)
        pose = vehicle.camera_pose(joints)
        J = np.empty((6, stop - start))
        J[:, :6] = vehicle.base_jacobian(pose)
        J[:, 6 : 6 + n] = -vehicle.joint_jacobian(joints)
        if len(springs):
            J[:, 6 + n :] = vehicle.compliance_jacobian(joints)
        at = slice(start, stop)
        independent = vehicle.per_scan_covariance(joints) + MIN_VARIANCE * np.eye(6)
        covariance = product(product(J, self.covariance[at, at]), J.T) + independent
        return pose, product(J, self.covariance[at]), covariance


def _n_springs(vehicle: Vehicle) -> int:
    """How many errors of springs a vehicle has in the state: of roll and pitch, or none."""
    return 0 if vehicle.equilibrium is None else 2
