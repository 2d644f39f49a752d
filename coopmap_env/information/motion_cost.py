"""Motion distance, Eq. 5: how far apart two camera poses are in configuration space."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.geometry import wrap_angle


def joint_distance(q: ArrayLike, current: ArrayLike, alpha: ArrayLike) -> NDArray[np.float64]:
    """Eq. 5 of a mount: d = sqrt(sum of alpha_i (q_i - q'_i)^2), shape (...,).

    Angles are not wrapped: a joint between its limits cannot take the other way round.

    Parameters
    ----------
    q : array_like, shape (..., n)
        New joint positions, radians and metres.
    current : array_like, shape (n,) or as `q`
        Where the joints are.
    alpha : array_like, shape (n,)
        Weights of the squares, >= 0.
    """
    delta = np.asarray(q, dtype=np.float64) - np.asarray(current, dtype=np.float64)
    return np.asarray(np.sqrt(delta**2 @ np.asarray(alpha, dtype=np.float64)))


def motion_distance(
    poses: ArrayLike, current: ArrayLike, alpha_position: float, alpha_heading: float
) -> NDArray[np.float64]:
    """Eq. 5 of a camera in the plane, the angle wrapped.

    Parameters
    ----------
    poses : array_like, shape (..., 3)
        New camera poses [x, y, heading], metres and radians.
    current : array_like, shape (3,)
        Where the camera is.
    """
    delta = np.asarray(poses, dtype=np.float64) - np.asarray(current, dtype=np.float64)
    delta[..., 2] = wrap_angle(delta[..., 2])
    return joint_distance(delta, np.zeros(3), [alpha_position, alpha_position, alpha_heading])
