"""How well a point fits a target, by how far it is from the surface: fields for the search."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from coopmap_env.localization.target import TargetModel

_MAX_VALUE = 255
"""Of a field's bytes: a point on the surface."""


@dataclass(frozen=True, eq=False)
class LikelihoodField:
    """A target's likelihood field and its max-pooled versions.

    Attributes
    ----------
    pooled : (l, nx, ny, nz) uint8 array
        255 exp(-d^2 / 2 width^2) at a distance d from the surface. Level k has the largest value
        of the 2^k x 2^k steps from a cell on towards +x and +y.
    origin : (3,) float array
        Lower corner of cell (0, 0, 0) in the target's frame, metres.
    cell : float
        Metres; half a step.
    """

    pooled: NDArray[np.uint8]
    origin: NDArray[np.float64]
    cell: float


@lru_cache(maxsize=8)
def likelihood_field(
    model: TargetModel, step: float, sigma: float, n_levels: int
) -> LikelihoodField:
    """The field of a target, of cells of half a step; kept, as it takes longer than a search."""
    cell = step / 2.0
    padding_cells = 2 * (
        2**n_levels - 1
    )  # cells by which the largest node reaches towards +x and +y
    surface_distances, origin = distance_field(model, cell, 2.5 * sigma)
    values = np.round(_MAX_VALUE * np.exp(-0.5 * (surface_distances / sigma) ** 2)).astype(np.uint8)
    values = np.pad(values, ((padding_cells, 0), (padding_cells, 0), (0, 0)))
    pooled = [values]
    for level in range(n_levels):
        values = values.copy()
        shift = 2 << level
        for axis in (0, 1):
            shifted = np.moveaxis(values, axis, 0)
            shifted[:-shift] = np.maximum(shifted[:-shift], shifted[shift:].copy())
        pooled.append(values)
    return LikelihoodField(
        np.stack(pooled), origin - np.array([padding_cells, padding_cells, 0]) * cell, cell
    )


@lru_cache(maxsize=16)
def distance_field(
    model: TargetModel, cell: float, padding: float
) -> tuple[NDArray[np.float32], NDArray[np.float64]]:
    """How far cells are from the surface (nx, ny, nz), metres, and the first one's corner (3,).

    The cells fill the box of the target and some room around it; kept, as it takes 5 ms.
    """
    origin = model.bounds[0] - padding
    shape = np.ceil((model.bounds[1] + padding - origin) / cell).astype(int)
    free = np.ones(shape, dtype=bool)
    free[tuple(np.floor((model.samples[0] - origin) / cell).astype(int).T)] = False
    return distance_transform_edt(free, cell).astype(np.float32), origin
