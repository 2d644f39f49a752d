"""Point clouds in the camera frame, and scans in the world frame with their uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.linear_algebra import are_finite
from coopmap_env.geometry import Pose
from coopmap_env.sensing.noise import RangeNoise


class ScanArrays(NamedTuple):
    """The arrays of a `Scan`, as kernels take them."""

    origin: NDArray[np.float64]
    points: NDArray[np.float64]
    covariances: NDArray[np.float64]
    hit: NDArray[np.bool_]


@dataclass(frozen=True)
class PointCloud:
    """Ends of the beams of one scan in the camera frame (x along the optical axis).

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Ends of the beams, metres. A beam that ends in the camera itself, at 0, observes nothing:
        its surface was too near to be measured.
    hit : ndarray of bool, shape (n,)
        True where a surface was measured; where False, the beam is free up to its point.

    Raises
    ------
    ValueError
        If a shape or a type is not as described.
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


@dataclass(frozen=True)
class Scan:
    """Beams of one camera in the world frame; the map is built from scans.

    Parameters
    ----------
    origin : ndarray, shape (D,)
        Camera position, metres.
    points : ndarray, shape (n, D)
        End of each beam, metres: the observed surface, or the end of the depth of field.
    covariances : ndarray, shape (n, D, D)
        Covariance of each observed point (Eqs. 1 and 3), square metres; unused where not `hit`.
    hit : ndarray of bool, shape (n,)
        True where the beam hit a surface, False where it reached the end of the depth of field.
    pose_covariance : ndarray, shape (6, 6), optional
        Covariance of the camera's pose in 3-D, as in `transform_cloud`: a part of all
        `covariances`, by an error that all points of the scan share. None or zeros if the pose is
        exact.

    Raises
    ------
    ValueError
        If shapes disagree.
    """

    origin: NDArray[np.float64]
    points: NDArray[np.float64]
    covariances: NDArray[np.float64]
    hit: NDArray[np.bool_]
    pose_covariance: NDArray[np.float64] | None = None

    def __post_init__(self) -> None:
        n, dimension = self.points.shape
        if (
            self.origin.shape != (dimension,)
            or self.covariances.shape != (n, dimension, dimension)
            or self.hit.shape != (n,)
        ):
            raise ValueError(
                f"a scan of {n} points needs origin ({dimension},), covariances "
                f"({n}, {dimension}, {dimension}) and hit ({n},); got {self.origin.shape}, "
                f"{self.covariances.shape}, {self.hit.shape}"
            )
        if self.pose_covariance is not None and self.pose_covariance.shape != (6, 6):
            raise ValueError(f"pose_covariance must be (6, 6), got {self.pose_covariance.shape}")

    @property
    def arrays(self) -> ScanArrays:
        """The scan, for kernels."""
        return ScanArrays(self.origin, self.points, self.covariances, self.hit)


class LowerTriangle(NamedTuple):
    """That of a symmetric matrix (3, 3)."""

    xx: float
    yx: float
    yy: float
    zx: float
    zy: float
    zz: float


@kernel
def pose_term(sigma: NDArray[np.float64], x: float, y: float, z: float) -> LowerTriangle:
    """J sigma J^T, which the covariance of the camera's pose adds to that of a point.

    (x, y, z) leads from the camera to the point. J = [I, -W] with W = [(x, y, z)]x, so that
    J sigma J^T = Stt + Str W + (Str W)^T + V W^T with V = W Srr; written out, without the zeros
    on the diagonal of W.
    """
    s = sigma
    v_xy, v_xz = y * s[5, 4] - z * s[4, 4], y * s[5, 5] - z * s[4, 5]
    v_yx, v_yy, v_yz = (
        z * s[3, 3] - x * s[5, 3],
        z * s[3, 4] - x * s[5, 4],
        z * s[3, 5] - x * s[5, 5],
    )
    v_zx, v_zy, v_zz = (
        x * s[4, 3] - y * s[3, 3],
        x * s[4, 4] - y * s[3, 4],
        x * s[4, 5] - y * s[3, 5],
    )
    return LowerTriangle(
        s[0, 0] + 2.0 * (s[0, 4] * z) - v_xy * z - 2.0 * (s[0, 5] * y) + v_xz * y,
        s[1, 0] - s[0, 3] * z + s[1, 4] * z - v_yy * z + (s[0, 5] * x - s[1, 5] * y) + v_yz * y,
        s[1, 1] - 2.0 * (s[1, 3] * z) + v_yx * z + 2.0 * (s[1, 5] * x) - v_yz * x,
        s[2, 0] + s[0, 3] * y + (s[2, 4] * z - s[0, 4] * x) - v_zy * z - s[2, 5] * y + v_zz * y,
        s[2, 1] + (s[1, 3] * y - s[2, 3] * z) + v_zx * z - s[1, 4] * x + s[2, 5] * x - v_zz * x,
        s[2, 2] + 2.0 * (s[2, 3] * y) - v_zx * y - 2.0 * (s[2, 4] * x) + v_zy * x,
    )


@borrowing_kernel
def largest_entry(sigma: NDArray[np.float64]) -> float:
    """The largest absolute value of a matrix."""
    largest = 0.0
    for i in range(sigma.shape[0]):
        for j in range(sigma.shape[1]):
            largest = max(largest, abs(sigma[i, j]))
    return largest


@kernel
def transform_points(
    points: NDArray[np.float64],
    T_world_camera: PlainTuple,
    noise: PlainTuple,
    sigma: NDArray[np.float64],
    scan: PlainTuple,
) -> None:
    """Fill a scan's points and covariances from points (n, 3) of the camera frame.

    `T_world_camera`, `noise` and `scan` are a plain `RigidTransform`, `NoiseParameters` and
    `ScanArrays`; `sigma` (6, 6) is the covariance of the camera's pose, [translation, rotation
    vector]. The covariance of a hit is that of Eqs. 1 and 3 plus the term of the pose; without a
    hit it is 0.
    """
    R, t = T_world_camera
    intrinsic, depth_factor, lateral_factor, exponent = noise
    _, points_world, C, hit = scan
    pose_is_uncertain = largest_entry(sigma) > 0.0
    for k in range(len(points)):
        x, y, z = points[k, 0], points[k, 1], points[k, 2]
        q_x = R[0, 0] * x + R[0, 1] * y + R[0, 2] * z
        q_y = R[1, 0] * x + R[1, 1] * y + R[1, 2] * z
        q_z = R[2, 0] * x + R[2, 1] * y + R[2, 2] * z
        points_world[k, 0], points_world[k, 1] = t[0] + q_x, t[1] + q_y
        points_world[k, 2] = t[2] + q_z
        if not hit[k]:
            for i in range(3):
                C[k, i, 0], C[k, i, 1], C[k, i, 2] = 0.0, 0.0, 0.0
            continue
        # Eq. 1; both lateral axes are alike, so Eq. 3 needs the optical axis in the world only
        square = x * x + y * y + z * z
        raised = square if exponent == 2.0 else power(math.sqrt(square), exponent)
        depth = (intrinsic * depth_factor * raised) ** 2
        lateral = (intrinsic * lateral_factor * raised) ** 2
        ahead_x, ahead_y, ahead_z = R[0, 0], R[1, 0], R[2, 0]
        along = depth - lateral
        xx, yx = along * ahead_x * ahead_x + lateral, along * ahead_y * ahead_x
        yy, zx = along * ahead_y * ahead_y + lateral, along * ahead_z * ahead_x
        zz, zy = along * ahead_z * ahead_z + lateral, along * ahead_z * ahead_y
        if pose_is_uncertain:
            term = pose_term(sigma, q_x, q_y, q_z)
            xx, yx, yy = xx + term.xx, yx + term.yx, yy + term.yy
            zx, zy, zz = zx + term.zx, zy + term.zy, zz + term.zz
        C[k, 0, 0], C[k, 0, 1], C[k, 0, 2] = xx, yx, zx
        C[k, 1, 0], C[k, 1, 1], C[k, 1, 2] = yx, yy, zy
        C[k, 2, 0], C[k, 2, 1], C[k, 2, 2] = zx, zy, zz


def transform_cloud(
    cloud: PointCloud,
    T_world_camera: Pose,
    noise: RangeNoise,
    pose_covariance: ArrayLike | None = None,
) -> Scan:
    """The scan of a point cloud: p = t + R r, covariance R diag(sigma^2) R^T + J Sigma J^T.

    sigma is Eq. 1 at the measured distance, the rotation into the world Eq. 3. The last term comes
    from the camera's uncertain pose, to first order, with J = [I, -[R r]x].

    Parameters
    ----------
    cloud : PointCloud
        n beams in the camera frame.
    T_world_camera : Pose
        The robot's estimate of its camera's pose.
    noise : RangeNoise
        The camera's noise model (Eq. 1).
    pose_covariance : array_like, shape (6, 6), optional
        Sigma of [translation, rotation vector], both in the world frame, metres and radians: the
        true camera is at t + dt with rotation exp([dw]x) R. Without it the pose is exact, and the
        scan has zeros.

    Returns
    -------
    Scan
        n beams in the world frame.

    Raises
    ------
    ValueError
        If the pose is not three-dimensional, or `pose_covariance` is not a covariance (6, 6).
    """
    if T_world_camera.translation.shape != (3,):
        raise ValueError(
            f"a point cloud needs a pose in 3-D, got translation {T_world_camera.translation.shape}"
        )
    n = len(cloud.points)
    transform = T_world_camera.arrays
    sigma = _validate_pose_covariance(pose_covariance)
    arrays = ScanArrays(
        transform.translation,
        np.empty((n, 3)),
        np.empty((n, 3, 3)),
        np.ascontiguousarray(cloud.hit),
    )
    transform_points(
        np.ascontiguousarray(cloud.points, dtype=np.float64),
        tuple(transform),
        tuple(noise.parameters),
        sigma,
        tuple(arrays),
    )
    return Scan(T_world_camera.translation, arrays.points, arrays.covariances, cloud.hit, sigma)


def _validate_pose_covariance(pose_covariance: ArrayLike | None) -> NDArray[np.float64]:
    """The covariance of a camera's pose, an array of the scan's own; zeros for None."""
    if pose_covariance is None:
        return np.zeros((6, 6))
    sigma = np.array(pose_covariance, dtype=np.float64, order="C")
    if sigma.shape != (6, 6) or not are_finite(sigma.ravel()):
        raise ValueError(f"pose_covariance must be finite and (6, 6), got {sigma.shape}: {sigma}")
    if not is_covariance(sigma):
        raise ValueError(
            f"pose_covariance must be symmetric and positive semi-definite, got {sigma}"
        )
    return sigma


@kernel
def is_covariance(sigma: NDArray[np.float64]) -> bool:
    """Whether a matrix is symmetric and has no negative eigenvalue, to 1e-9 of its largest entry.

    Tested by the Cholesky factorisation of the matrix plus this tolerance on its diagonal;
    eigenvalues take ten times as long, and this runs at every scan.
    """
    n = len(sigma)
    rounding = 1e-9 * largest_entry(sigma)
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
