"""Likelihood fields of a target: how well a point fits it, by its distance from the surface."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.elementary import exp_array
from coopmap_env.localization.target import TargetModel

_MAX_VALUE = 255
"""Value of a field at the surface: fields are stored in bytes."""


class FieldLevel(NamedTuple):
    """One level of a `LikelihoodField`, for kernels."""

    values: NDArray[np.uint8]
    """Shape (nx, ny, nz)."""
    origin: NDArray[np.float64]
    """Lower corner (3,) of cell (0, 0, 0) in the target's frame, metres."""
    cell: float
    """Edge of a cell, metres."""


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """A target's likelihood field and its max-pooled versions.

    Attributes
    ----------
    pooled : (l, nx, ny, nz) uint8 array
        255 exp(-d^2 / 2 sigma^2) at a distance d from the surface. Level k has the largest value
        of the 2^k x 2^k steps from a cell on towards +x and +y.
    origin : (3,) float array
        Lower corner of cell (0, 0, 0) in the target's frame, metres.
    cell : float
        Metres; half a step.
    """

    pooled: NDArray[np.uint8]
    origin: NDArray[np.float64]
    cell: float

    @property
    def finest(self) -> FieldLevel:
        """The field that is not pooled."""
        return FieldLevel(self.pooled[0], self.origin, self.cell)


@lru_cache(maxsize=8)
def likelihood_field(
    model: TargetModel, step: float, sigma: float, n_levels: int
) -> LikelihoodField:
    """The field of a target, with cells of half a step.

    Cached, because it takes longer than a search.
    """
    cell = step / 2.0
    padding = 2 * (2**n_levels - 1)  # cells by which the largest node reaches towards +x and +y
    distances, origin, _ = distance_field(model, cell, 2.5 * sigma)
    values = np.round(_MAX_VALUE * exp_array(-0.5 * (distances / sigma) ** 2)).astype(np.uint8)
    values = np.pad(values, ((padding, 0), (padding, 0), (0, 0)))
    pooled = [values]
    for level in range(n_levels):
        values = values.copy()
        shift = 2 << level
        for axis in (0, 1):
            shifted = np.moveaxis(values, axis, 0)
            shifted[:-shift] = np.maximum(shifted[:-shift], shifted[shift:].copy())
        pooled.append(values)
    origin = origin - np.array([padding, padding, 0]) * cell
    return freeze(LikelihoodField(np.stack(pooled), origin, cell))


class DistanceField(NamedTuple):
    """Distances of cells from a target's surface."""

    distances: NDArray[np.float32]
    """Shape (nx, ny, nz), metres."""
    origin: NDArray[np.float64]
    """Lower corner (3,) of cell (0, 0, 0) in the target's frame, metres."""
    cell: float
    """Edge of a cell, metres."""


@lru_cache(maxsize=16)
def distance_field(model: TargetModel, cell: float, padding: float) -> DistanceField:
    """The distance field of a target's bounding box and some padding around it, metres.

    Cached, because it takes long.
    """
    from scipy.ndimage import distance_transform_edt  # a third of a second, seldom needed

    origin = model.bounds[0] - padding
    shape = np.ceil((model.bounds[1] + padding - origin) / cell).astype(int)
    free = np.ones(shape, dtype=bool)
    free[tuple(np.floor((model.samples[0] - origin) / cell).astype(int).T)] = False
    distances = distance_transform_edt(free, cell).astype(np.float32)
    return freeze(DistanceField(distances, origin, cell))
