"""Settings of the field environment, in metres and radians."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated, Literal

from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings
from coopmap_env.information import FieldRatingSettings
from coopmap_env.localization import (
    CorrectionSettings,
    FiducialSettings,
    RegistrationSettings,
    TrackingSettings,
)
from coopmap_env.mapping import BeamModel, LogOddsRange
from coopmap_env.robots import CollisionSettings
from coopmap_env.sensing import DepthCamera, RangeNoise

CropSide = Annotated[int, Bounds(at_least=4)]


@dataclass(frozen=True)
class FieldSettings(Settings):
    """Cameras, map, motion and physics of the field environment; not the scene or the mounts.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    camera: DepthCamera = field(default_factory=DepthCamera)
    noise: RangeNoise = field(default_factory=RangeNoise)
    beam: BeamModel = field(
        default_factory=lambda: BeamModel(
            0.01, 0.9995, "partial", behind=0.97, posterior_cutoff=0.99, surface_fusion="mean"
        )
    )
    """Surfaces fill a part of their voxels, and other beams pass beside them: a beam that passes
    is weaker evidence than one that ends. Tuned on training worlds by `studies.field.calibration`:
    a lower `free` has less log-loss, but maps more of the occupied voxels as free, with which links
    would then collide."""
    log_odds_range: LogOddsRange = field(default_factory=LogOddsRange)
    rating: FieldRatingSettings = field(default_factory=FieldRatingSettings)
    physics: Literal["kinematic", "stepped"] = "kinematic"
    """Stepped physics, or its final state computed at once; both model the suspension. Without a
    collision, cameras of the mast and TIAGo end within 0.2 mm and 0.01 degrees of each other; with
    one, mounts stop up to 6 cm apart."""
    max_stiffness_error: Annotated[float, Bounds(at_least=0, at_most=0.8)] = 0.2
    """Largest fraction by which the true stiffness of a vehicle's roll and pitch differs from the
    described one, drawn for each episode. Robots know `Suspension.stiffness_tolerance` only. With
    0.8 each mount of the library still stands in all of its postures and leans by less than 4
    degrees; with 0.9 a TIAGo would fall over. A mount of your own on softer springs may do so
    earlier."""
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    """Search for the target, and acceptance of its pose."""
    correction: CorrectionSettings = field(default_factory=CorrectionSettings)
    """Correction of camera poses by fiducials."""
    fiducials: FiducialSettings = field(default_factory=FiducialSettings)
    """Which peaks of the map become fiducials."""
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    """Tracking of fiducials in depth images."""
    motion: CollisionSettings = field(default_factory=CollisionSettings)
    """Resolution of collision checks, and margins of links to what is not known to be free."""
    motion_planner: Literal["straight", "ompl"] = "straight"
    """Whether a motion is straight in joint space or, where that is blocked, planned by OMPL."""
    scan_time: NonNegative = 2.0
    """Seconds that a scan takes; see the argument `max_time`. How fast joints move, the URDF of the
    mount says."""
    initial_free_radius: Positive = 1.0
    """Metres around each vehicle's axis that are known to be free: it was parked there."""
    collision_cost: NonNegative = 0.05
    """Cost of a collision in every reward, as a fraction of the largest NI."""
    crop_cells: tuple[CropSide, CropSide] = (40, 16)
    """Sides of the observed crop of the map, horizontal and vertical, in its own cells."""
    crop_pooling: Annotated[int, Bounds(at_least=1, largest=64)] = 2
    """Voxels along the side of a cell of the observed crop."""
    candidate_views: Literal["coarse", "exact"] = "coarse"
    """Whether the candidates in an observation are rated on the map pooled to half its resolution,
    eight times as fast, or on the map itself. In six training worlds the coarse NI is off by 1.4 %
    of its maximum (root mean square), and of 32 candidates the best one by the exact rating is the
    best one in 94 % and among the first three in 100 %."""
    max_grid_poses: Annotated[int, Bounds(at_least=1, largest=1_000_000)] = 2_000
    """Poses at most in the grid over the joint limits, which discretizes the configuration space
    for exhaustive search and raster scan."""

    def __post_init__(self) -> None:
        if isinstance(self.crop_cells, list):
            object.__setattr__(self, "crop_cells", tuple(self.crop_cells))
        super().__post_init__()

    @classmethod
    def v0(cls) -> FieldSettings:
        """The readings and constants of version v0 of the ids, to reproduce its results."""
        return cls(
            beam=BeamModel(0.02, 0.998, "partial"),
            rating=FieldRatingSettings(K=0.1, interpretation="literal", hidden="printed"),
            max_stiffness_error=0.0,
            correction=CorrectionSettings(prior="encoders", smoothing=False, min_patch_pixels=6),
            candidate_views="exact",
        )
