"""Eqs. 1 and 3 and the contribution of the camera pose, point by point."""

import numpy as np

from coopmap_env.sensing import rotate_covariances


def cross_matrix(v):
    """[v]x, so that [v]x w is the cross product of v and w."""
    return np.cross(np.eye(3), v)


def covariance(point, R, noise, pose_covariance):
    """Covariance (3, 3) in the world of a point (3,) measured in the camera frame."""
    sigma = noise.standard_deviations(np.linalg.norm(point), 3)
    J = np.hstack([np.eye(3), -cross_matrix(R @ point)])
    return rotate_covariances(np.diag(sigma**2), R) + J @ pose_covariance @ J.T
