"""Estimators of a camera's pose from fiducials: Eqs. 10 to 13, and rigid solutions.

A fiducial has the position r_i in the base frame, and its image point (u_i, v_i) with the scale k_i
gives

    k_i (f, u_i, v_i) = R_01 r_i + x                                            (Eqs. 10, 11)

in the camera frame; our optical axis is the first one. g_01 = [R_01 x] maps the base frame to the
camera frame, so the camera's pose is its inverse.

The paper treats the nine entries of R_01 as independent unknowns (Eq. 12). With small errors that
is simple and accurate enough, but it needs four points that are not in one plane, and weights all
points and all directions equally. `rigid_pose` requires R_01 to be a rotation (Umeyama 1991);
`gaussian_pose` also weights each fiducial by its information matrix.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.linear_algebra import eigh, inverse, product, solve
from coopmap_env.geometry import Pose, apply_displacement, nearest_rotation, skew
from coopmap_env.robots import PoseEstimate

Array = NDArray[np.float64]

MIN_EIGENVALUE_RATIO = 1e-6
"""Ratio of eigenvalues of the points' scatter: with a smaller ratio of smallest to largest they are
in one plane, with a smaller ratio of middle to largest in one line."""


class DegenerateGeometryError(ValueError):
    """Fiducials that do not determine the pose: too few, in one line or in one plane."""


def back_project(image_points: ArrayLike, scales: ArrayLike, focal_length: float = 1.0) -> Array:
    """Eq. 10: k (f, u, v) of image points (m, 2) with their scales k (m,), shape (m, 3).

    For a stereo pair k is depth over focal length, which is baseline over disparity.
    """
    uv = np.asarray(image_points, dtype=np.float64)
    f = np.full(len(uv), focal_length)
    return np.asarray(scales, dtype=np.float64)[:, None] * np.column_stack([f, uv])


def linear_transform(base_points: ArrayLike, observed_points: ArrayLike) -> Array:
    """Eq. 12: g_01 = U R^T (R R^T)^-1, shape (3, 4), of homogeneous points in the columns of R.

    Parameters
    ----------
    base_points : array_like, shape (m, 3)
        r_i in the base frame, metres.
    observed_points : array_like, shape (m, 3)
        k_i (f, u_i, v_i) in the camera frame, see `back_project`: the columns of U.

    Raises
    ------
    DegenerateGeometryError
        If there are fewer than four points, or all lie in one plane.
    """
    r, u = _validated_pairs(base_points, observed_points)
    if len(r) < 4 or _eigenvalue_ratios(r)[0] < MIN_EIGENVALUE_RATIO:
        raise DegenerateGeometryError(
            f"Eq. 12 needs four points that are not in one plane, got {len(r)}"
            f"{'' if len(r) < 4 else ' in a plane'}"
        )
    # about the centroid of the points, where the normal equations are well conditioned
    centroid = r.mean(axis=0)
    R_tilde = np.column_stack([r - centroid, np.ones(len(r))]).T
    g = product(product(u.T, R_tilde.T), inverse(product(R_tilde, R_tilde.T)))
    g[:, 3] -= product(g[:, :3], centroid)
    return np.asarray(g)


def pose_from_transform(g: Array) -> Pose:
    """T_base_camera of g_01 (3, 4): the nearest rotation, and the translation that fits it."""
    R = nearest_rotation(g[:, :3])
    return Pose(-product(R.T, g[:, 3]), R.T)


def linear_pose(base_points: ArrayLike, observed_points: ArrayLike) -> Pose:
    """T_base_camera by Eq. 12 and the nearest rotation, about the points' centroid.

    The translation is computed again for that rotation. With the translation of g_01, the
    difference of its nine entries from a rotation would move the camera by that times its distance
    from the points.

    Raises
    ------
    DegenerateGeometryError
        See `linear_transform`.
    """
    r, u = _validated_pairs(base_points, observed_points)
    R = nearest_rotation(linear_transform(r, u)[:, :3])
    return Pose(r.mean(axis=0) - product(R.T, u.mean(axis=0)), R.T)


class RecursiveMoments:
    """Eq. 13: recursive mean and covariance of a series of values.

    mean_{i+1} = (i mean_i + x_{i+1}) / (i + 1), and the covariance (over i, not i - 1) by

    C_{i+1} = i/(i+1) C_i + i/(i+1)^2 (x_{i+1} - mean_i)(x_{i+1} - mean_i)^T
    """

    def __init__(self, dimension: int) -> None:
        self.count = 0
        self.mean = np.zeros(dimension)
        self.covariance = np.zeros((dimension, dimension))

    def add(self, value: ArrayLike) -> None:
        """Add one more value (d,)."""
        i = self.count
        d = np.asarray(value, dtype=np.float64) - self.mean
        self.covariance = i / (i + 1) * self.covariance + i / (i + 1) ** 2 * np.outer(d, d)
        self.mean = self.mean + d / (i + 1)
        self.count = i + 1


def recursive_pose(base_points: ArrayLike, observed_points: ArrayLike) -> tuple[Pose, Array]:
    """Eq. 12 of the first 4, 5, ... points, and Eq. 13 over what they give.

    Returns
    -------
    pose : Pose
        T_base_camera of the mean of g_01.
    covariance : ndarray, shape (12, 12)
        Of the entries of g_01, row by row, as Eq. 13 has them.

    Raises
    ------
    DegenerateGeometryError
        If no first points are placed well enough.
    """
    r, u = _validated_pairs(base_points, observed_points)
    moments = RecursiveMoments(12)
    for m in range(4, len(r) + 1):
        if _eigenvalue_ratios(r[:m])[0] >= MIN_EIGENVALUE_RATIO:
            moments.add(linear_transform(r[:m], u[:m]).ravel())
    if not moments.count:
        raise DegenerateGeometryError(
            f"{len(r)} points, of which no first ones are out of one plane"
        )
    return pose_from_transform(moments.mean.reshape(3, 4)), moments.covariance


def rigid_pose(
    base_points: ArrayLike, observed_points: ArrayLike, weights: ArrayLike | None = None
) -> Pose:
    """T_base_camera by weighted least squares over rotations and translations (Umeyama 1991).

    Parameters
    ----------
    base_points, observed_points : array_like, shape (m, 3)
    weights : array_like, shape (m,), optional
        Inverse variances.

    Raises
    ------
    DegenerateGeometryError
        If there are fewer than three points, or all lie in one line.
    """
    r, u = _validated_pairs(base_points, observed_points)
    w = np.ones(len(r)) if weights is None else np.asarray(weights, dtype=np.float64)
    if len(r) < 3 or _eigenvalue_ratios(r, w)[1] < MIN_EIGENVALUE_RATIO:
        raise DegenerateGeometryError(
            f"a rigid solution needs three points that are not in one line, got {len(r)}"
            f"{'' if len(r) < 3 else ' in a line'}"
        )
    w = w / w.sum()
    centroid_r, centroid_u = product(w, r), product(w, u)
    R = nearest_rotation(product((r - centroid_r).T, w[:, None] * (u - centroid_u)))
    return Pose(centroid_r - product(R, centroid_u), R)


def consistent_subset(
    base_points: ArrayLike, observed_points: ArrayLike, deviations: ArrayLike, sigmas: float = 3.0
) -> NDArray[np.bool_]:
    """Which fiducials moved as one rigid body, shape (m,); the others are outliers.

    A rigid motion keeps all distances. Two fiducials agree if their distance has changed by no more
    than its error. Fiducials are added in the order of how many others they agree with, as long as
    each agrees with all that were added before: a greedy clique. (Maximum cliques of such graphs:
    Bailey et al. 2000.)

    Parameters
    ----------
    base_points, observed_points : array_like, shape (m, 3)
    deviations : array_like, shape (m,)
        Standard deviation of the difference of a pair's two points, along its worst axis, metres.
    sigmas : float, optional
        Standard deviations of a distance's change that still agree.
    """
    r, u = _validated_pairs(base_points, observed_points)
    s = np.asarray(deviations, dtype=np.float64)
    distance_change = np.abs(_pairwise_distances(r) - _pairwise_distances(u))
    agree = distance_change <= sigmas * np.sqrt(s[:, None] ** 2 + s**2) + 1e-12
    selected = np.zeros(len(r), dtype=np.bool_)
    for i in np.argsort(-agree.sum(axis=1), kind="stable"):
        selected[i] = agree[i, selected].all()
    return selected


class GaussianPose(NamedTuple):
    """The maximum-likelihood pose of a camera, with its covariance."""

    estimate: PoseEstimate
    """T_base_camera with its covariance (6, 6), a displacement in the base frame."""
    squared_mahalanobis: Array
    """Shape (m,): squared Mahalanobis distances of the fiducials' residuals."""


def gaussian_pose(
    base_points: ArrayLike,
    observed_points: ArrayLike,
    information: ArrayLike,
    start: Pose,
    prior: ArrayLike | None = None,
    iterations: int = 5,
) -> GaussianPose:
    """T_base_camera of maximum likelihood, with a Gaussian for each fiducial.

    Gauss-Newton over displacements of the camera in the base frame. The residual of a fiducial is
    r_i - (t + R u_i), its information matrix that of both points together; in the null space of a
    singular one the fiducial does not count.

    Parameters
    ----------
    base_points, observed_points : array_like, shape (m, 3)
    information : array_like, shape (m, 3, 3)
        Inverse covariances of the residuals, in the base frame, at about `start`.
    start : Pose
        Initial T_base_camera: the prediction.
    prior : array_like, shape (6, 6), optional
        Covariance of `start`, if it is a measurement too.
    iterations : int, optional

    Raises
    ------
    DegenerateGeometryError
        If fiducials and prior do not determine a direction of the pose.
    """
    r, u = _validated_pairs(base_points, observed_points)
    weights = np.asarray(information, dtype=np.float64)
    P = np.zeros((6, 6)) if prior is None else inverse(prior)
    pose, x = start, np.zeros(6)
    for _ in range(iterations):
        rotated = product(u, pose.rotation.T)
        J = np.concatenate([np.broadcast_to(np.eye(3), weights.shape), -skew(rotated)], axis=2)
        e = r - rotated - pose.translation
        weighted = product(weights, J).reshape(-1, 6)
        H = product(weighted.T, J.reshape(-1, 6)) + P
        scale = np.sqrt(np.diag(H))
        if not scale.all() or eigh(H / np.outer(scale, scale))[0][0] < 1e-12:
            raise DegenerateGeometryError(f"{len(r)} fiducials do not determine the pose")
        step = solve(H, product(weighted.T, e.ravel()) - product(P, x))
        pose, x = apply_displacement(pose, step), x + step
    e = r - pose.transform(u)
    squared_distances = (product(weights, e[..., None])[..., 0] * e).sum(axis=-1)
    return GaussianPose(PoseEstimate(pose, inverse(H)), squared_distances)


def _validated_pairs(base_points: ArrayLike, observed_points: ArrayLike) -> tuple[Array, Array]:
    """Both sets of points as arrays (m, 3).

    Raises
    ------
    ValueError
        If shapes differ or a value is not finite.
    """
    r = np.asarray(base_points, dtype=np.float64)
    u = np.asarray(observed_points, dtype=np.float64)
    if r.ndim != 2 or r.shape[1] != 3 or r.shape != u.shape:
        raise ValueError(f"fiducials need two sets of points (m, 3), got {r.shape}, {u.shape}")
    if not (np.isfinite(r).all() and np.isfinite(u).all()):
        raise ValueError("a point of a fiducial is not finite")
    return r, u


def _eigenvalue_ratios(points: Array, weights: Array | None = None) -> tuple[float, float]:
    """Smallest and middle eigenvalue of the points' scatter, over the largest."""
    w = np.ones(len(points)) if weights is None else weights
    centered = points - product(w, points) / w.sum()
    smallest, second, largest = eigh(product(centered.T, w[:, None] * centered))[0]
    return (smallest / largest, second / largest) if largest > 0 else (0.0, 0.0)


def _pairwise_distances(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points[:, None] - points, axis=-1))
