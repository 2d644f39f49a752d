"""Fiducials from the probabilistic map (Section 2.5): peaks, the balls around them, their choice.

Local peaks of the map are potential fiducials. At each, spherical expansion finds the largest ball
inside which values fall off outwards; the nearest voxel beyond it is the first that increases
again. A fiducial's score is

    radius * probability at the peak / distance to the camera

and the best ones in view are used, until they leave it.

Unknown voxels hold one half, as in the paper, so a ball also ends at the border of known free
space. The map clamps its values, so whole surfaces form a plateau. Where the paper's peak is the
voxel that is occupied most certainly, here among equals that one counts whose surface point is
known best (trace of its precision), and then the one with the lowest index. A ball may extend along
a plateau: values do not increase there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.arguments import check_array_shapes
from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings
from coopmap_env.geometry import Pose
from coopmap_env.localization.correction._peaks import (
    BallLimits,
    PeakMap,
    SelectedPeaks,
    SelectionLimits,
    ball_offsets,
    select_peaks,
)
from coopmap_env.localization.correction.voxels_in_view import Frustum
from coopmap_env.mapping import OccupancyMap, to_log_odds_fixed
from coopmap_env.sensing import DepthCamera

Probability = Annotated[float, Bounds(at_least=0, below=1)]


@dataclass(frozen=True)
class FiducialSettings(Settings):
    """Which peaks become fiducials, and how many are kept."""

    max_fiducials: Annotated[int, Bounds(at_least=1, largest=10_000)] = 32
    """The error of a pose falls with their root, the time to track them grows with them."""
    min_peak_probability: Annotated[float, Bounds(above=0.5, below=1)] = 0.9
    """More certain voxels are better fiducials (Section 2.5). 0.6 would hardly add any, for next
    to a surface most voxels have a more certain neighbour."""
    min_rise: Probability = 0.05
    """Probability by which a value must exceed that of its neighbour nearer to the peak to end the
    ball: on a surface values differ by hundredths, whatever its shape."""
    max_radius: Annotated[float, Bounds(above=0, largest=10)] = 0.4
    """Metres: the visible part of a larger thing depends on the side that it is seen from."""
    min_spacing: NonNegative = 0.3
    """Metres between new fiducials and all others: neighbours have the same errors, and near to
    each other they determine no rotation."""
    max_distance: Positive = 5.0
    """Metres from the camera: there the range error of Eq. 1 is 4 cm, twice as large as that of a
    position predicted from the encoders."""
    border_fraction: Probability = 0.1
    """Part of the half field of view, at its edge, where none is newly selected: it would soon
    leave the view, and half of their region may be outside."""
    occlusion_tolerance: NonNegative = 0.3
    """Metres in front of a fiducial in which occupied voxels do not hide it: a ray that meets the
    ground at a slope of 1 : 3 runs through the ground's own voxels for as long."""


@dataclass(frozen=True, eq=False)
class Fiducials:
    """k fiducials: first previous ones, in their order, then new ones by falling score."""

    cells: NDArray[np.int64]
    """(k,) flat indices of the peaks' voxels, which identify the fiducials."""
    positions: NDArray[np.float64]
    """(k, 3) r_i of Eq. 10: merged surface points of these voxels, world frame, metres."""
    covariances: NDArray[np.float64]
    """(k, 3, 3) of the positions (Eq. 2), square metres."""
    radii: NDArray[np.float64]
    """(k,) of their balls, metres."""
    peaks: NDArray[np.float64]
    """(k,) probabilities at the peaks."""
    scores: NDArray[np.float64]
    """(k,) radius * peak / distance to the camera."""

    def __post_init__(self) -> None:
        k = len(self.cells)
        check_array_shapes(self, [(k,), (k, 3), (k, 3, 3), (k,), (k,), (k,)])

    def __len__(self) -> int:
        return len(self.cells)


def select_fiducials(
    map_: OccupancyMap,
    T_world_camera: Pose,
    camera: DepthCamera,
    settings: FiducialSettings | None = None,
    previous: Fiducials | None = None,
) -> Fiducials:
    """Select the fiducials that a camera is expected to see from a pose (Section 2.5).

    A fiducial is in view if its position lies in the field of view and within range, and no
    occupied voxel (sampled, P >= 1/2) lies between.

    Parameters
    ----------
    map_ : OccupancyMap
        3-D.
    T_world_camera : Pose
        Predicted pose of the camera.
    camera : DepthCamera
    settings : FiducialSettings, optional
    previous : Fiducials, optional
        Those of the last scan. They stay while they are in view and likely enough, and no voxel
        around them is more likely; one that is as likely and known better does not matter.

    Returns
    -------
    Fiducials
        None at all if the camera is outside the map.

    Raises
    ------
    ValueError
        If the map or the pose is planar, or the previous ones are not of this map.
    """
    settings = settings or FiducialSettings()
    grid = map_.grid
    if grid.dimension != 3 or T_world_camera.translation.shape != (3,):
        raise ValueError(
            f"fiducials are selected in 3-D maps by poses in space: got a map {grid.shape}, "
            f"a camera at {T_world_camera.translation}"
        )
    previous_cells = np.empty(0, dtype=np.int64) if previous is None else previous.cells
    if len(previous_cells) and not (
        previous_cells.min() >= 0 and previous_cells.max() < grid.n_cells
    ):
        raise ValueError(
            f"previous fiducials must be voxels in [0, {grid.n_cells}), got {previous_cells}"
        )
    position, scale, n = grid.to_cell_units(T_world_camera.translation), grid.resolution, 0
    selected = SelectedPeaks.empty(int(settings.max_fiducials))
    probability = map_.log_odds_range.probability
    if grid.contains(np.floor(position)):
        intrinsics, max_radius = camera.intrinsics, settings.max_radius / scale
        n = select_peaks(
            PeakMap(
                map_.arrays, probability, map_.surface_sums, map_.surface_index.rows, scale
            ),
            Frustum(
                T_world_camera.arrays.rotation, position, intrinsics.tan_x, intrinsics.tan_y,
                camera.near / scale, min(camera.far, settings.max_distance) / scale,
            ),
            BallLimits(ball_offsets(max_radius), settings.min_rise, max_radius),
            SelectionLimits(
                to_log_odds_fixed(settings.min_peak_probability), settings.border_fraction,
                settings.min_spacing / scale, settings.occlusion_tolerance / scale,
            ),
            np.ascontiguousarray(previous_cells, dtype=np.int64),
            selected,
        )  # fmt: skip
    cells = selected.cells[:n]
    return Fiducials(
        cells,
        selected.positions[:n] * scale + np.array(grid.origin),
        selected.covariances[:n],
        selected.radii[:n] * scale,
        probability[map_.log_odds_fixed[cells] + map_.log_odds_range.clamp],
        selected.scores[:n],
    )
