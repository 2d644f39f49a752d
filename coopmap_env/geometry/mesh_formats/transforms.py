"""Transforms of scenes in mesh files, and turns from their axes to z up."""

import math

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.linear_algebra import length
from coopmap_env.geometry.rotations import rotation_about_axis, rotation_from_quaternion

Z_UP_FROM_Y_UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""The file's x is right, y up and z towards the viewer."""
Z_UP_FROM_X_UP = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""The file's -y is right, x up and z towards the viewer."""


def quaternion_transform(xyzw: NDArray[np.float64]) -> NDArray[np.float64]:
    """T (4, 4) of a quaternion (4,); see `rotation_from_quaternion`."""
    T = np.eye(4)
    T[:3, :3] = rotation_from_quaternion(xyzw)
    return T


def axis_angle_transform(axis: NDArray[np.float64], degrees: float) -> NDArray[np.float64]:
    """T (4, 4) of a turn about an axis (3,); no turn if the axis has no length."""
    norm = length(axis)
    if norm == 0.0:
        return np.eye(4)
    T = np.eye(4)
    T[:3, :3] = rotation_about_axis(axis / norm, math.radians(degrees))
    return T
