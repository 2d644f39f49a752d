"""A mount's joints, normalized to [-1, 1] as in actions, and the sampling of poses.

Poses are sampled as 32-bit actions, so that a pose that a planner has chosen is restored bit for
bit when its action is decoded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import unchecked_division_kernel


@dataclass(frozen=True, eq=False)
class JointSpace:
    """The box of a mount's joint limits.

    Parameters
    ----------
    lower, upper : ndarray, shape (n,)
        Radians or metres; a joint without limits ranges from -pi to pi.
    max_grid_poses : int
        Largest number of poses in `grid`.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    max_grid_poses: int

    def __post_init__(self) -> None:
        for name, whole in (("lower", -math.pi), ("upper", math.pi)):
            limit = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, np.where(np.isfinite(limit), limit, whole))

    @cached_property
    def _half(self) -> NDArray[np.float64]:
        """Half the range of each joint (n,)."""
        return 0.5 * (self.upper - self.lower)

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.lower)

    def denormalize(self, action: ArrayLike) -> NDArray[np.float64]:
        """Joints (..., n) of normalized values in [-1, 1]."""
        return self.lower + self._half * (np.asarray(action, dtype=np.float64) + 1.0)

    def normalize(self, q: ArrayLike) -> NDArray[np.float32]:
        """Normalized values (..., n) in [-1, 1] of joints, clipped at the limits.

        Raises
        ------
        ValueError
            If there are not n joints.
        """
        joints = np.ascontiguousarray(q, dtype=np.float64)
        if joints.shape[-1:] != self.lower.shape:
            raise ValueError(f"joints must be (..., {self.n}), got {joints.shape}")
        out = np.empty(joints.shape, dtype=np.float32)
        _normalize(joints.reshape(-1), self.lower, self._half, out.reshape(-1))
        return out

    def sample(self, k: int, rng: np.random.Generator) -> NDArray[np.float64]:
        """Joints (k, n), uniformly at random inside the limits."""
        return self.denormalize(2.0 * rng.random((k, self.n), dtype=np.float32) - np.float32(1.0))

    @property
    def grid_steps(self) -> int:
        """Values of each joint in the grid."""
        steps = round(self.max_grid_poses ** (1.0 / self.n))
        return max(steps - (steps**self.n > self.max_grid_poses), 1)

    def grid(self) -> NDArray[np.float64]:
        """Joints (steps**n, n): the middles of equal parts of every joint, the last one fastest."""
        values = (2.0 * np.arange(self.grid_steps) + 1.0) / self.grid_steps - 1.0
        axes = np.meshgrid(*(values,) * self.n, indexing="ij")
        return self.denormalize(np.stack(axes, axis=-1).reshape(-1, self.n).astype(np.float32))

    def grid_index(self, q: ArrayLike) -> NDArray[np.int64]:
        """Index (...,) in `grid` of the pose in whose part of the joint space the joints lie."""
        fraction = (self.normalize(q).astype(np.float64) + 1.0) / 2.0
        parts = np.minimum((fraction * self.grid_steps).astype(np.int64), self.grid_steps - 1)
        return np.asarray(parts @ self.grid_steps ** np.arange(self.n)[::-1])


@unchecked_division_kernel
def _normalize(
    q: NDArray[np.float64],
    lower: NDArray[np.float64],
    half: NDArray[np.float64],
    out: NDArray[np.float32],
) -> None:
    """Write the normalized values (k n,) of joints (k n,); limits are (n,)."""
    for i in range(len(q)):
        joint = i % len(lower)
        out[i] = min(max((q[i] - lower[joint]) / half[joint] - 1.0, -1.0), 1.0)
