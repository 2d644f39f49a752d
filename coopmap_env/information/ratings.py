"""Common to both rating functions: motion distance (Eq. 5), rating (Eq. 9), and arguments.

`PlanarRatingFunction` and `FieldRatingFunction` have the same methods. Each takes a map, camera
poses and a `ViewContext`: planar poses are ids of a `PoseLattice`, field poses are `CameraPoses`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import kernel
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Spheres, wrap_angle
from coopmap_env.information.settings import RatingSettings

ReservedMask = NDArray[np.uint8]
"""Shape (n_cells,): 1 at cells that a teammate's next scan will observe. Planners and views do not
count them. None stands for no such cells."""
CameraPoses = tuple[ArrayLike, ArrayLike]
"""Rotations R_world_camera (k, 3, 3) and translations (k, 3), metres."""


@dataclass(frozen=True, eq=False)
class ViewContext:
    """What, besides the map and the poses, decides which cells a view shows."""

    reserved_mask: ReservedMask | None = None
    """Cells that do not count, because a teammate will observe them."""
    occluder_spheres: Spheres | None = None
    """Spheres that cover the other robots and hide what is behind them. 3-D only."""
    coarse: bool = False
    """Whether the map is pooled to half its resolution, which is four to five times as fast. 3-D
    only."""


WHOLE_VIEW = ViewContext()
"""Nothing is reserved, no robot is in view, full resolution."""


@dataclass(frozen=True)
class Ratings:
    """The terms of Eq. 9 for k poses."""

    new_information: NDArray[np.float64]
    """NI, nats, shape (k,)."""
    distance: NDArray[np.float64]
    """d of Eq. 5, shape (k,)."""
    motion_cost: NDArray[np.float64]
    """K d**n, nats, shape (k,)."""
    occupancy: NDArray[np.float64]
    """P at the camera's position, shape (k,)."""
    rating: NDArray[np.float64]
    """RF, shape (k,)."""

    @classmethod
    def from_terms(
        cls,
        new_information: NDArray[np.float64],
        distance: NDArray[np.float64],
        occupancy: NDArray[np.float64],
        constants: RatingSettings,
    ) -> Ratings:
        """Eq. 9: RF = (NI - K d**n) (1 - P)."""
        out = np.empty((3, len(distance)))
        out[1] = occupancy
        cost_law = float(constants.K), float(constants.exponent)
        write_ratings(cost_law, new_information, distance, out)
        return cls(new_information, distance, *out)


@kernel
def write_ratings(
    cost_law: tuple[float, float],
    ni: NDArray[np.float64],
    d: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Eq. 9: write K d**n and RF of k poses to the first and the last row of `out` (3, k).

    P is in the row between, `cost_law` is K and n.
    """
    K, exponent = cost_law
    cost, p, rating = out[0], out[1], out[2]
    for k in range(len(d)):
        cost[k] = K * power(d[k], exponent)
        rating[k] = (ni[k] - cost[k]) * (1.0 - p[k])


def joint_distance(q: ArrayLike, current: ArrayLike, alpha: ArrayLike) -> NDArray[np.float64]:
    """Eq. 5 of a mount: d = sqrt(sum of alpha_i (q_i - q'_i)^2), shape (...,).

    Angles are not wrapped: a joint with limits cannot turn in the other direction.

    Parameters
    ----------
    q : array_like, shape (..., n)
        New joint values, radians and metres.
    current : array_like, shape (n,) or as `q`
        Joint values now.
    alpha : array_like, shape (n,)
        Weights of the squares, >= 0.
    """
    delta = np.asarray(q, dtype=np.float64) - np.asarray(current, dtype=np.float64)
    return np.sqrt(product(delta**2, alpha))


def motion_distance(
    poses: ArrayLike, current: ArrayLike, alpha_position: float, alpha_heading: float
) -> NDArray[np.float64]:
    """Eq. 5 of a planar camera; the angle is wrapped.

    Parameters
    ----------
    poses : array_like, shape (..., 3)
        New camera poses [x, y, heading], metres and radians.
    current : array_like, shape (3,)
        Camera pose now.
    alpha_position, alpha_heading : float
        Weights of squared metres and squared radians.
    """
    delta = np.asarray(poses, dtype=np.float64) - np.asarray(current, dtype=np.float64)
    delta[..., 2] = wrap_angle(delta[..., 2])
    return joint_distance(delta, np.zeros(3), [alpha_position, alpha_position, alpha_heading])
