"""A depth camera on a map of one resolution: what the kernels over views need, held together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import minus_q_ln_q
from coopmap_env.information.field.frustum import PIXEL, Frustum
from coopmap_env.information.field.views import entropies, histograms, view
from coopmap_env.information.gray import GrayTable
from coopmap_env.information.settings import RatingConstants
from coopmap_env.mapping import LogOddsRange, VoxelGrid
from coopmap_env.sensing import DepthCamera

Known = tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8], tuple[int, ...]]
"""Flat levels, sampled and claimed cells, and the shape, at the resolution of a `Sight`."""
Spheres = tuple[ArrayLike, ArrayLike]
"""Centres (s, 3) and radii (s,), metres in the world frame: bodies that hide what is behind."""


@dataclass(frozen=True)
class Sight:
    """A camera on the cells of one grid."""

    grid: VoxelGrid
    frustum: Frustum
    gray: GrayTable
    """By the squared distance from the camera, in quarters of a cell, rounded down."""
    n_gray: int
    clamp: int

    @classmethod
    def of(
        cls,
        camera: DepthCamera,
        grid: VoxelGrid,
        constants: RatingConstants,
        log_odds_range: LogOddsRange,
        voxel: float,
    ) -> Sight:
        """Prepare the tables; `voxel` metres are the unit of the distances in Eq. 8."""
        unit = grid.resolution / voxel
        frustum = Frustum.of(camera, grid.resolution, PIXEL * unit)
        quarters = np.arange(int(4 * frustum.far**2) + 2)
        gray = GrayTable.of(
            np.sqrt(quarters) / 2 * unit,
            frustum.far * unit,
            constants.n_gray,
            constants.reading,
            log_odds_range,
        )
        return cls(grid, frustum, gray, constants.n_gray, log_odds_range.clamp)

    @cached_property
    def optics(self) -> tuple[Any, ...]:
        """As kernels want it: lens, directions of the depth buffer, most runs."""
        f = self.frustum
        return f.lens, f.directions, f.most_columns(self.grid.shape)

    @cached_property
    def tables(self) -> tuple[Any, ...]:
        """As kernels want it: bins of sampled voxels, distance class, unknown bin, clamp."""
        return self.gray.sampled, self.gray.distance_class, self.gray.unknown, self.clamp

    @cached_property
    def _terms(self) -> NDArray[np.float64]:
        return minus_q_ln_q(self.frustum.n_visible)

    def spheres(self, bodies: Spheres | None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Spheres in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        if bodies is None:
            return np.zeros((0, 3)), np.zeros(0)
        centers, radii = (np.asarray(part, dtype=np.float64) for part in bodies)
        if centers.shape != (*radii.shape, 3) or radii.ndim != 1:
            raise ValueError(
                "bodies are centres (s, 3) and radii (s,), "
                f"got shapes {centers.shape} and {radii.shape}"
            )
        if not (np.isfinite(centers).all() and np.isfinite(radii).all()):
            raise ValueError(f"bodies have a value that is not finite: {centers}, {radii}")
        return self.grid.cells(centers), radii / self.grid.resolution

    def histograms(
        self,
        known: Known,
        rotations: NDArray[np.float64],
        translations: NDArray[np.float64],
        bodies: Spheres | None,
    ) -> NDArray[np.int64]:
        """Gray levels in view of each pose, shape (k, 2 n_gray): sampled voxels, then unknown."""
        out = np.empty((len(rotations), 2 * self.n_gray), dtype=np.int64)
        positions = self.grid.cells(translations)
        histograms(known, positions, rotations, self.spheres(bodies), self.optics, self.tables, out)
        return out

    def view(
        self,
        known: Known,
        rotation: NDArray[np.float64],
        translation: NDArray[np.float64],
        bodies: Spheres | None,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Flat numbers of the voxels in view, and their squared distances in quarters of a cell."""
        cells, distances = view(
            known, self.grid.cells(translation), rotation, self.spheres(bodies), self.optics
        )
        return cells, distances

    def entropies(self, histogram: NDArray[np.int64]) -> NDArray[np.float64]:
        """NI (Eqs. 6, 7) of each row of `histograms`, nats, shape (k,)."""
        out = np.empty(len(histogram))
        entropies(histogram, self._terms, out)
        return out
