"""Settings of the field world, in metres and radians."""

from __future__ import annotations

import math
from dataclasses import MISSING, dataclass, field, fields
from typing import Literal

from coopmap_env.core.arguments import check_choice, check_positive_int
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


@dataclass(frozen=True)
class FieldSettings:
    """Everything about cameras, map, motion and physics that is not the scene or the mount.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    camera: DepthCamera = field(default_factory=DepthCamera)
    noise: RangeNoise = field(default_factory=RangeNoise)
    beam: BeamModel = field(default_factory=lambda: BeamModel(0.02, 0.998, "partial"))
    """Surfaces fill a part of their voxels, and other beams pass beside them: a beam that passes
    says less than one that ends. Tuned on training worlds; free = 0.005 has a tenth less log-loss,
    but calls a third more of the occupied voxels free, into which links would then run."""
    log_odds_range: LogOddsRange = field(default_factory=LogOddsRange)
    rating: FieldRatingSettings = field(default_factory=FieldRatingSettings)
    physics: Literal["kinematic", "stepped"] = "kinematic"
    """Stepped physics, or its end state computed at once; both know the suspension. Cameras of
    the mast and TIAGo end within 0.2 mm and 0.01 degrees of each other where nothing is touched; a
    mount that touches something is stopped up to 6 cm apart."""
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    """How the target is searched for, and when it counts as found."""
    correction: CorrectionSettings = field(default_factory=CorrectionSettings)
    """How camera poses are corrected by fiducials."""
    fiducials: FiducialSettings = field(default_factory=FiducialSettings)
    """Which peaks of the map become fiducials."""
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    """How fiducials are found again in a depth image."""
    motion: CollisionSettings = field(default_factory=CollisionSettings)
    """How closely motions are checked, and how far links keep from what is not known to be free."""
    motion_planner: Literal["straight", "ompl"] = "straight"
    """Whether a motion is straight in joint space or, where that is blocked, planned by OMPL."""
    initial_free_radius: float = 1.0
    """Metres around each vehicle's axis that are known to be free: somebody parked it there."""
    contact_cost: float = 0.05
    """Paid for bumping into something, as a share of the largest NI, in every reward."""
    crop_cells: tuple[int, int] = (40, 16)
    """Sides of the observed local map, along the ground and upwards, in its own cells."""
    crop_pooling: int = 2
    """Voxels along the side of a cell of the observed local map."""
    max_grid_poses: int = 2_000
    """Poses at most in the grid over the joints' limits that stands for the whole configuration
    space in an exhaustive search and gives the order of a raster scan."""

    def __post_init__(self) -> None:
        for part in fields(self):
            value, default = getattr(self, part.name), part.default_factory
            kind = None if default is MISSING else type(default())
            if kind is not None and not isinstance(value, kind):
                raise ValueError(
                    f"FieldSettings.{part.name} must be {kind.__name__}, got {value!r}"
                )
        for name in ("contact_cost", "initial_free_radius"):
            if isinstance(getattr(self, name), bool | str | None):
                raise ValueError(
                    f"FieldSettings.{name} must be a number, got {getattr(self, name)!r}"
                )
        if not (math.isfinite(self.contact_cost) and self.contact_cost >= 0):
            raise ValueError(
                f"FieldSettings.contact_cost must be finite and >= 0, got {self.contact_cost}"
            )
        if not (math.isfinite(self.initial_free_radius) and self.initial_free_radius > 0):
            raise ValueError(
                f"FieldSettings.initial_free_radius must be finite and > 0, got {self.initial_free_radius}"
            )
        check_choice("FieldSettings.physics", self.physics, ("kinematic", "stepped"))
        check_choice("FieldSettings.motion_planner", self.motion_planner, ("straight", "ompl"))
        view = tuple(self.crop_cells) if isinstance(self.crop_cells, tuple | list) else ()
        if len(view) != 2 or not all(isinstance(n, int) and n >= 4 for n in view):
            raise ValueError(
                f"FieldSettings.crop_cells must be two whole numbers of at least 4, "
                f"got {self.crop_cells}"
            )
        object.__setattr__(self, "crop_cells", view)
        check_positive_int("FieldSettings.crop_pooling", self.crop_pooling)
        check_positive_int("FieldSettings.max_grid_poses", self.max_grid_poses)
