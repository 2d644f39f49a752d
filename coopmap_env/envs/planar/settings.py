"""Settings of the planar world, in metres and radians."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

from coopmap_env.information import RatingSettings
from coopmap_env.mapping import BeamModel, LogOddsRange
from coopmap_env.sensing import PlanarCamera, RangeNoise


@dataclass(frozen=True)
class PlanarSettings:
    """Everything about robots, camera and map that is not the scene.

    The defaults fit cells of one metre. `for_resolution` keeps the same geometry in cells on a
    finer or coarser grid; `dataclasses.replace` changes single values.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    camera: PlanarCamera = field(default_factory=PlanarCamera)
    noise: RangeNoise = field(default_factory=RangeNoise)
    beam: BeamModel = field(default_factory=BeamModel)
    log_odds_range: LogOddsRange = field(default_factory=LogOddsRange)
    rating: RatingSettings = field(default_factory=RatingSettings)
    n_headings: int = 16
    """Headings of the configuration space; see `PoseLattice`."""
    reach: float = 20.0
    """Metres: one action moves the camera at most so far ahead or back, and so far to a side: a
    depth of field, beyond which little can be known."""
    initial_free_radius: float = 3.0
    """Metres around each start that are known to be free: the robot stands there."""
    max_start_distance: float = 20.0
    """Metres: teammates start no further than this from the first robot, a depth of field."""
    crop_cells: int = 48
    """Side of the observed local map, cells: the default depth of field lies inside."""

    def __post_init__(self) -> None:
        for name in ("reach", "initial_free_radius", "max_start_distance"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"PlanarSettings.{name} must be finite and > 0, got {value}")
        if not isinstance(self.crop_cells, int) or self.crop_cells < 4:
            raise ValueError(
                f"PlanarSettings.crop_cells must be a whole number of at least 4, "
                f"got {self.crop_cells}"
            )

    @classmethod
    def for_resolution(cls, resolution: float) -> PlanarSettings:
        """Scale every length of the defaults, so that a view spans as many cells as before.

        Range noise keeps its size in cells, and the rating its weight of a move by one cell.
        """
        base = cls()
        return replace(
            base,
            camera=replace(base.camera, depth_of_field=base.camera.depth_of_field * resolution),
            noise=replace(
                base.noise,
                intrinsic=base.noise.intrinsic * resolution ** (1 - base.noise.exponent),
            ),
            rating=replace(base.rating, alpha_position=base.rating.alpha_position / resolution**2),
            reach=base.reach * resolution,
            initial_free_radius=base.initial_free_radius * resolution,
            max_start_distance=base.max_start_distance * resolution,
        )
