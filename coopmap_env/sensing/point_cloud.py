"""What a depth camera measured, and how it is placed into the world with its uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.sensing.noise import RangeNoise
from coopmap_env.sensing.scan import Scan


@dataclass(frozen=True)
class PointCloud:
    """Where the beams of one look ended, in the camera frame (x along the optical axis).

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Ends of the beams, metres. A beam that ends in the camera itself, at 0, says nothing at
        all: its surface was too near to be measured.
    hit : ndarray of bool, shape (n,)
        True where a surface was measured; where False, the beam is clear up to its point.

    Raises
    ------
    ValueError
        If shapes or types are others.
    """

    points: NDArray[np.float64]
    hit: NDArray[np.bool_]

    def __post_init__(self) -> None:
        n = len(self.points)
        if self.points.shape != (n, 3) or self.hit.shape != (n,) or self.hit.dtype != np.bool_:
            raise ValueError(
                "a point cloud needs points (n, 3) and as many bools hit (n,), got "
                f"{self.points.shape} and {self.hit.shape} of {self.hit.dtype}"
            )


@njit(cache=True, nogil=True)
def transform_points(points, hit, R, t, noise, sigma, points_world, covariances):
    """Fill points and covariances of the world frame; `noise` is (S, T depth, T lateral, n).

    `sigma` (6, 6) is the covariance of the camera's pose, [translation, rotation vector]; the
    covariance of a point (n, 3, 3), Eqs. 1 and 3 and the pose's share, stays 0 without a hit.
    """
    intrinsic, depth_factor, lateral_factor, exponent = noise
    W = np.zeros((3, 3))
    V = np.zeros((3, 3))
    q = np.zeros(3)
    pose_is_uncertain = np.any(sigma != 0.0)
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        for i in range(3):
            q[i] = R[i, 0] * x + R[i, 1] * y + R[i, 2] * z
            points_world[k, i] = t[i] + q[i]
        if not hit[k]:
            covariances[k] = 0.0
            continue
        # Eq. 1; both lateral axes are alike, so Eq. 3 needs the optical axis in the world only
        square = x * x + y * y + z * z
        if exponent != 2.0:
            square = math.sqrt(square) ** exponent
        depth = (intrinsic * depth_factor * square) ** 2
        lateral = (intrinsic * lateral_factor * square) ** 2
        for i in range(3):
            for j in range(i + 1):
                covariances[k, i, j] = (depth - lateral) * R[i, 0] * R[j, 0]
            covariances[k, i, i] += lateral
        if pose_is_uncertain:
            # J = [I, -W] with W = [q]x: J S J^T = Stt + Str W + (Str W)^T + W Srr W^T
            W[0, 1], W[0, 2], W[1, 2] = -q[2], q[1], -q[0]
            W[1, 0], W[2, 0], W[2, 1] = q[2], -q[1], q[0]
            for i in range(3):
                for j in range(3):
                    V[i, j] = 0.0
                    for m in range(3):
                        V[i, j] += W[i, m] * sigma[3 + m, 3 + j]
            for i in range(3):
                for j in range(i + 1):
                    pose_term = sigma[i, j]
                    for m in range(3):
                        pose_term += sigma[i, 3 + m] * W[m, j] + sigma[j, 3 + m] * W[m, i]
                        pose_term += V[i, m] * W[j, m]
                    covariances[k, i, j] += pose_term
        for i in range(3):
            for j in range(i):
                covariances[k, j, i] = covariances[k, i, j]


def transform_cloud(
    cloud: PointCloud,
    T_world_camera: Pose,
    noise: RangeNoise,
    pose_covariance: ArrayLike | None = None,
) -> Scan:
    """A look in the world frame: p = t + R r, with covariance R diag(sigma^2) R^T + J Sigma J^T.

    sigma is Eq. 1 at the measured distance, the turn into the world Eq. 3. The last term is the
    share of the camera's own pose, to first order, with J = [I, -[R r]x].

    Parameters
    ----------
    cloud : PointCloud
        n beams in the camera frame.
    T_world_camera : Pose
        Where the robot believes that its camera stands.
    noise : RangeNoise
        What the camera states of its uncertainty (Eq. 1).
    pose_covariance : array_like, shape (6, 6), optional
        Sigma of [translation, rotation vector], both in the world frame, metres and radians: the
        true camera stands at t + dt, turned by exp([dw]x) R. Without it the pose is exact.

    Raises
    ------
    ValueError
        If the pose is not one in space, or the covariance is not a covariance (6, 6).
    """
    if T_world_camera.translation.shape != (3,):
        raise ValueError(
            f"a point cloud is placed by a pose in space, got {T_world_camera.translation.shape}"
        )
    n = len(cloud.points)
    points, covariances = np.empty((n, 3)), np.empty((n, 3, 3))
    transform_points(
        np.ascontiguousarray(cloud.points, dtype=np.float64), np.ascontiguousarray(cloud.hit),
        np.ascontiguousarray(T_world_camera.rotation),
        np.ascontiguousarray(T_world_camera.translation),
        (float(noise.intrinsic), float(noise.depth), float(noise.lateral), float(noise.exponent)),
        _validate_pose_covariance(pose_covariance), points, covariances,
    )  # fmt: skip
    return Scan(T_world_camera.translation, points, covariances, cloud.hit)


def _validate_pose_covariance(pose_covariance: ArrayLike | None) -> NDArray[np.float64]:
    """A covariance of the camera's pose, or none at all as zeros."""
    if pose_covariance is None:
        return np.zeros((6, 6))
    sigma = np.ascontiguousarray(pose_covariance, dtype=np.float64)
    if sigma.shape != (6, 6) or not math.isfinite(sigma.sum()):
        raise ValueError(f"pose_covariance must be finite and (6, 6), got {sigma.shape}: {sigma}")
    if not is_covariance(sigma):
        raise ValueError(
            f"pose_covariance must be symmetric and positive semi-definite, got {sigma}"
        )
    return sigma


@njit(cache=True, nogil=True)
def is_covariance(sigma):
    """Whether a matrix is symmetric and has no negative eigenvalue, to 1e-9 of its largest entry.

    It has none if the factors of Cholesky exist of what is larger by this; eigenvalues take ten
    times as long, and this is asked at every look.
    """
    n = len(sigma)
    rounding = 1e-9 * np.abs(sigma).max()
    if rounding == 0.0:
        return True
    L = np.zeros((n, n))
    for i in range(n):
        for j in range(i + 1):
            if abs(sigma[i, j] - sigma[j, i]) > rounding:
                return False
            rest = sigma[i, j] + (rounding if i == j else 0.0)
            for k in range(j):
                rest -= L[i, k] * L[j, k]
            if i == j:
                if rest <= 0.0:
                    return False
                L[i, i] = math.sqrt(rest)
            else:
                L[i, j] = rest / L[j, j]
    return True
