"""Fiducials from the probabilistic map (section 2.5): peaks, the balls around them, their choice.

Local peaks of the map are potential fiducials. At each, spherical expansion finds the largest ball
inside which values fall off outwards; the nearest voxel beyond it is the first that increases
again. A fiducial's score is

    radius * probability at the peak / distance to the camera

and the best ones in view are used, until they leave it.

Unknown voxels hold one half, as in the paper, so a ball also ends where free space that is known
does. The map clamps its values, so whole surfaces stand on a plateau. Where the paper's peak is the
voxel that is occupied most certainly, here among equals that one counts whose surface point is
known best (trace of its precision), and then the one with the lowest number. A ball may run along
a plateau: values do not increase there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from coopmap_env.geometry.transforms import Pose
from coopmap_env.localization.correction.peaks import ball_offsets, select_peaks
from coopmap_env.mapping.log_odds import to_log_odds_fixed
from coopmap_env.mapping.occupancy_map import OccupancyMap
from coopmap_env.sensing.depth_camera import DepthCamera


@dataclass(frozen=True)
class FiducialSettings:
    """Which peaks become fiducials, and how many are kept.

    Raises
    ------
    ValueError
        With the value, if one is out of range.
    """

    max_fiducials: int = 32
    """Kept at most: the error of a pose falls with its root, the time to track grows with it."""
    min_peak_probability: float = 0.9
    """Probability: surer voxels are better fiducials (section 2.5). 0.6 would hardly add any, for
    next to a surface most voxels have a neighbour that is surer."""
    min_rise: float = 0.05
    """Probability by which a value must exceed that of its neighbour nearer to the peak to end the
    ball: on a surface values differ by hundredths that say nothing of its shape."""
    max_radius: float = 0.4
    """Metres: what is larger shows more of itself from one side than from another."""
    min_spacing: float = 0.3
    """Metres between new fiducials and all others: neighbours err alike, and near to each other
    they fix no rotation."""
    max_distance: float = 5.0
    """Metres from the camera: there the range error of Eq. 1 is 4 cm, twice as large as that of a
    position predicted from the encoders."""
    border_fraction: float = 0.1
    """Share of the half field of view, at its edge, in which none is newly chosen: it would soon
    leave the view, and half of its region may be outside."""
    occlusion_tolerance: float = 0.3
    """Metres in front of a fiducial in which occupied voxels do not hide it: a ray that meets the
    ground at a slope of 1 : 3 runs through the ground's own voxels for as long."""

    def __post_init__(self) -> None:
        if not (isinstance(self.max_fiducials, int | np.integer) and self.max_fiducials >= 1):
            raise ValueError(
                f"FiducialSettings.max_fiducials must be a whole number of at least 1: {self.max_fiducials}"
            )
        if not 0.5 < self.min_peak_probability < 1:
            raise ValueError(
                f"FiducialSettings.min_peak_probability must lie in (0.5, 1), got {self.min_peak_probability}"
            )
        for name in ("min_rise", "border_fraction"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(
                    f"FiducialSettings.{name} must lie in [0, 1), got {getattr(self, name)}"
                )
        for name in ("max_radius", "max_distance", "min_spacing", "occlusion_tolerance"):
            value, positive = getattr(self, name), name in ("max_radius", "max_distance")
            if not (math.isfinite(value) and value >= 0) or (positive and value == 0):
                bound = "> 0" if positive else ">= 0"
                raise ValueError(
                    f"FiducialSettings.{name} must be finite and {bound} metres, got {value}"
                )


@dataclass(frozen=True, eq=False)
class Fiducials:
    """k fiducials: first those kept, in the order they had, then new ones by falling score."""

    cells: NDArray[np.int64]
    """(k,) flat numbers of the peaks' voxels, which name the fiducials."""
    positions: NDArray[np.float64]
    """(k, 3) r_i of Eq. 10: merged surface points (Eq. 4) of these voxels, world frame, metres."""
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
        shapes = [getattr(self, entry.name).shape for entry in fields(self)]
        if shapes != [(k,), (k, 3), (k, 3, 3), (k,), (k,), (k,)]:
            raise ValueError(f"arrays of {k} fiducials cannot have the shapes {shapes}")

    def __len__(self) -> int:
        return len(self.cells)


def select_fiducials(
    map_: OccupancyMap,
    T_world_camera: Pose,
    camera: DepthCamera,
    settings: FiducialSettings | None = None,
    previous: Fiducials | None = None,
) -> Fiducials:
    """Choose the fiducials that a camera is expected to see from a pose (section 2.5).

    A fiducial is in view if its position lies in the field of view and within range, and no
    occupied voxel (sampled, P >= 1/2) lies between.

    Parameters
    ----------
    map_ : OccupancyMap
        3-D; what is known.
    T_world_camera : Pose
        Where the camera is believed to stand.
    camera : DepthCamera
    settings : FiducialSettings, optional
    kept : Fiducials, optional
        Those used before. They stay while they are in view, likely enough, and no voxel around
        them is more likely; that one as likely is now known better does not matter.

    Returns
    -------
    Fiducials
        None at all if the camera is outside the map.

    Raises
    ------
    ValueError
        If the map or the pose is planar, or `previous` are not of this map.
    """
    settings = settings or FiducialSettings()
    grid = map_.grid
    if grid.dimension != 3 or T_world_camera.translation.shape != (3,):
        raise ValueError(
            f"fiducials are chosen in space: a map {grid.shape}, "
            f"a camera at {T_world_camera.translation}"
        )
    previous_cells = np.empty(0, dtype=np.int64) if previous is None else previous.cells
    if len(previous_cells) and not (
        previous_cells.min() >= 0 and previous_cells.max() < grid.n_cells
    ):
        raise ValueError(
            f"fiducials to keep must be voxels in [0, {grid.n_cells}), got {previous_cells}"
        )
    position, scale = grid.to_cell_units(T_world_camera.translation), grid.resolution
    k, n = int(settings.max_fiducials), 0
    cells, radii, scores = np.empty(k, dtype=np.int64), np.empty(k), np.empty(k)
    positions, covariances = np.empty((k, 3)), np.empty((k, 3, 3))
    if grid.contains(np.floor(position)):
        frustum = (
            math.tan(camera.horizontal_field_of_view / 2),
            math.tan(camera.vertical_field_of_view / 2),
            camera.near / scale, min(camera.far, settings.max_distance) / scale,
        )  # fmt: skip
        max_radius = settings.max_radius / scale
        n = select_peaks(
            (map_.log_odds_fixed, map_.sampled_mask, map_.precision, map_.information_vector, grid.shape_3d, scale),
            (np.ascontiguousarray(T_world_camera.rotation), position, frustum),
            (map_.log_odds_range.probability, ball_offsets(max_radius), settings.min_rise, max_radius),
            to_log_odds_fixed(settings.min_peak_probability), settings.border_fraction,
            settings.min_spacing / scale, settings.occlusion_tolerance / scale,
            np.ascontiguousarray(previous_cells, dtype=np.int64),
            cells, positions, covariances, radii, scores,
        )  # fmt: skip
    cells = cells[:n]
    peaks = map_.log_odds_range.probability[map_.log_odds_fixed[cells] + map_.log_odds_range.clamp]
    positions = positions[:n] * scale + np.array(grid.origin)
    return Fiducials(cells, positions, covariances[:n], radii[:n] * scale, peaks, scores[:n])
