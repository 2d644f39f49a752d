"""A joint Gaussian, conditioned on a linear measurement as textbooks write it."""

import numpy as np


def condition_gaussian(mean, covariance, H, z, R):
    """Mean and covariance of x ~ N(mean, covariance), given z = H x + N(0, R)."""
    S = H @ covariance @ H.T + R
    K = covariance @ H.T @ np.linalg.inv(S)
    return mean + K @ (z - H @ mean), covariance - K @ S @ K.T
