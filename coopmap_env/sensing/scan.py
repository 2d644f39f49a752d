"""One look of one camera: points with their Gaussian uncertainty."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Scan:
    """Beams of one camera, in the world frame; what the map is made from.

    Parameters
    ----------
    origin : ndarray, shape (D,)
        Camera position, metres.
    points : ndarray, shape (n, D)
        Where each beam ended, metres: the observed surface, or the end of the depth of field.
    covariances : ndarray, shape (n, D, D)
        Covariance of each observed point (Eqs. 1 and 3), square metres; unused where not `hit`.
    hit : ndarray of bool, shape (n,)
        True where the beam met a surface, False where it ran out of its depth of field.

    Raises
    ------
    ValueError
        If shapes disagree.
    """

    origin: NDArray[np.float64]
    points: NDArray[np.float64]
    covariances: NDArray[np.float64]
    hit: NDArray[np.bool_]

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
