"""A depth camera on a map of one resolution: what the kernels over views need, held together."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.information.entropy import entropy_terms
from coopmap_env.information.field.frustum import MAX_PIXEL_ANGLE, Frustum
from coopmap_env.information.field.views import entropies, histograms, view
from coopmap_env.information.gray import GrayLevelTable
from coopmap_env.information.settings import RatingConstants
from coopmap_env.mapping import LogOddsRange, VoxelGrid
from coopmap_env.sensing import DepthCamera

MapArrays = tuple[NDArray[np.int32], NDArray[np.uint8], NDArray[np.uint8], tuple[int, ...]]
"""Flat levels, sampled and claimed cells, and the shape, at the resolution of a `ViewTables`."""
Spheres = tuple[ArrayLike, ArrayLike]
"""Centres (s, 3) and radii (s,), metres in the world frame: bodies that hide what is behind."""


@dataclass(frozen=True)
class ViewTables:
    """A camera on the cells of one grid."""

    grid: VoxelGrid
    frustum: Frustum
    gray: GrayLevelTable
    """By the squared distance from the camera, in quarters of a cell, rounded down."""
    n_gray_bins: int
    clamp: int

    @classmethod
    def from_camera(
        cls,
        camera: DepthCamera,
        grid: VoxelGrid,
        constants: RatingConstants,
        log_odds_range: LogOddsRange,
        distance_unit: float,
    ) -> ViewTables:
        """Prepare the tables; `distance_unit` metres are the unit of the distances in Eq. 8."""
        unit = grid.resolution / distance_unit
        frustum = Frustum.from_camera(camera, grid.resolution, MAX_PIXEL_ANGLE * unit)
        quarters = np.arange(int(4 * frustum.far**2) + 2)
        gray = GrayLevelTable.from_distances(
            np.sqrt(quarters) / 2 * unit,
            frustum.far * unit,
            constants.n_gray_bins,
            constants.interpretation,
            log_odds_range,
        )
        return cls(grid, frustum, gray, constants.n_gray_bins, log_odds_range.clamp)

    @cached_property
    def camera_arrays(self) -> tuple[Any, ...]:
        """As kernels want it: lens, directions of the depth buffer, most runs."""
        f = self.frustum
        return f.projection, f.directions, f.max_runs(self.grid.shape)

    @cached_property
    def tables(self) -> tuple[Any, ...]:
        """As kernels want it: bins of sampled voxels, distance class, unknown bin, clamp."""
        return self.gray.sampled, self.gray.distance_class, self.gray.unknown, self.clamp

    @cached_property
    def _entropy_terms(self) -> NDArray[np.float64]:
        return entropy_terms(self.frustum.max_visible_cells)

    def spheres(
        self, occluder_spheres: Spheres | None
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Spheres in cells of the grid.

        Raises
        ------
        ValueError
            If the shapes do not fit, or a value is not finite.
        """
        if occluder_spheres is None:
            return np.zeros((0, 3)), np.zeros(0)
        centers, radii = (np.asarray(part, dtype=np.float64) for part in occluder_spheres)
        if centers.shape != (*radii.shape, 3) or radii.ndim != 1:
            raise ValueError(
                "occluder_spheres are centres (s, 3) and radii (s,), "
                f"got shapes {centers.shape} and {radii.shape}"
            )
        if not (np.isfinite(centers).all() and np.isfinite(radii).all()):
            raise ValueError(
                f"occluder_spheres have a value that is not finite: {centers}, {radii}"
            )
        return self.grid.to_cell_units(centers), radii / self.grid.resolution

    def histograms(
        self,
        map_arrays: MapArrays,
        rotations: NDArray[np.float64],
        translations: NDArray[np.float64],
        occluder_spheres: Spheres | None,
    ) -> NDArray[np.int64]:
        """Gray levels in view of each pose, shape (k, 2 n_gray_bins): sampled voxels, then unknown."""
        out = np.empty((len(rotations), 2 * self.n_gray_bins), dtype=np.int64)
        positions = self.grid.to_cell_units(translations)
        histograms(
            map_arrays,
            positions,
            rotations,
            self.spheres(occluder_spheres),
            self.camera_arrays,
            self.tables,
            out,
        )
        return out

    def view(
        self,
        map_arrays: MapArrays,
        rotation: NDArray[np.float64],
        translation: NDArray[np.float64],
        occluder_spheres: Spheres | None,
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """Flat numbers of the voxels in view, and their squared distances in quarters of a cell."""
        cells, distances = view(
            map_arrays,
            self.grid.to_cell_units(translation),
            rotation,
            self.spheres(occluder_spheres),
            self.camera_arrays,
        )
        return cells, distances

    def entropies(self, histogram: NDArray[np.int64]) -> NDArray[np.float64]:
        """NI (Eqs. 6, 7) of each row of `histograms`, nats, shape (k,)."""
        out = np.empty(len(histogram))
        entropies(histogram, self._entropy_terms, out)
        return out
