"""Poses from pairs of points, as the formulas are written: pair by pair."""

from itertools import combinations

import numpy as np


def affine_fit(base_points, observed_points):
    """The (3, 4) matrix that leads from homogeneous points to others with least squares."""
    homogeneous = np.column_stack([base_points, np.ones(len(base_points))])
    return np.linalg.lstsq(homogeneous, observed_points, rcond=None)[0].T


def sum_of_squares(pose, base_points, observed_points, information):
    """Sum of squared residuals r - T u, each in its own information matrix."""
    total = 0.0
    for r, u, W in zip(base_points, observed_points, information, strict=True):
        e = r - (pose.rotation @ u + pose.translation)
        total += e @ W @ e
    return total


def distances_agree(base_points, observed_points, deviations, i, j, sigmas):
    """Whether the distance of two fiducials has kept, to `sigmas` standard deviations."""
    before = np.linalg.norm(base_points[i] - base_points[j])
    after = np.linalg.norm(observed_points[i] - observed_points[j])
    return abs(before - after) <= sigmas * np.hypot(deviations[i], deviations[j])


def largest_clique(base_points, observed_points, deviations, sigmas):
    """Size of the largest set in which all agree with each other, by trying every set."""
    n = len(base_points)
    for k in range(n, 1, -1):
        for members in combinations(range(n), k):
            if all(
                distances_agree(base_points, observed_points, deviations, i, j, sigmas)
                for i, j in combinations(members, 2)
            ):
                return k
    return min(n, 1)
