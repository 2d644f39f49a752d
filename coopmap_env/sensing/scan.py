"""Point clouds in the camera frame, and scans in the world frame with their uncertainty."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import PlainTuple, inlined_kernel, kernel
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


@inlined_kernel
def add_pose_term(
    sigma: NDArray[np.float64],
    q: NDArray[np.float64],
    W: NDArray[np.float64],
    V: NDArray[np.float64],
    covariances: NDArray[np.float64],
    k: int,
) -> None:
    """Add J sigma J^T to the lower triangle of point k's covariance.

    `q` (3,) leads from the camera to the point; W and V are buffers (3, 3), W with a diagonal of 0.
    J = [I, -W] with W = [q]x: J S J^T = Stt + Str W + (Str W)^T + W Srr W^T.
    """
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
    _, points_world, covariances, hit = scan
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
        raised = square if exponent == 2.0 else power(math.sqrt(square), exponent)
        depth = (intrinsic * depth_factor * raised) ** 2
        lateral = (intrinsic * lateral_factor * raised) ** 2
        for i in range(3):
            for j in range(i + 1):
                covariances[k, i, j] = (depth - lateral) * R[i, 0] * R[j, 0]
            covariances[k, i, i] += lateral
        if pose_is_uncertain:
            add_pose_term(sigma, q, W, V, covariances, k)
        for i in range(3):
            for j in range(i):
                covariances[k, j, i] = covariances[k, i, j]


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
    if sigma.shape != (6, 6) or not math.isfinite(sigma.sum()):
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
