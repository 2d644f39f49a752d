"""Settings of the planar environment, in metres and radians."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import Annotated

from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings
from coopmap_env.information import PlanarRatingSettings
from coopmap_env.mapping import BeamModel, LogOddsRange
from coopmap_env.robots.planar.motion_time import LatticeSpeeds
from coopmap_env.sensing import PlanarCamera, RangeNoise


@dataclass(frozen=True)
class PlanarSettings(Settings):
    """Robots, camera and map of the planar environment; not the scene.

    The defaults fit cells of one metre. `for_resolution` keeps the same geometry in cells on a
    finer or coarser grid; `dataclasses.replace` changes single values.

    Raises
    ------
    ValueError
        If a value is outside of its range.
    """

    camera: PlanarCamera = field(default_factory=PlanarCamera)
    noise: RangeNoise = field(default_factory=RangeNoise)
    beam: BeamModel = field(
        default_factory=lambda: BeamModel(
            free=0.0003, occupied=0.9995, behind=0.93, surface_fusion="mean"
        )
    )
    """Tuned on training worlds by `studies.section3.sensor_tuning`."""
    log_odds_range: LogOddsRange = field(default_factory=lambda: LogOddsRange(0.9999))
    """Of the cells with P at v0's limit of 0.001, less than 1 in 10,000 is occupied. A limit of
    0.99999 has a log-loss that is lower by less than a hundredth, but a cell that is wrong takes
    more observations to be corrected."""
    rating: PlanarRatingSettings = field(default_factory=PlanarRatingSettings)
    n_headings: Annotated[int, Bounds(at_least=1, largest=3_600)] = 16
    """Headings of the configuration space; see `PoseLattice`."""
    reach: Positive = 20.0
    """Metres: the most that one action moves the camera ahead or back, and to either side. By
    default a depth of field, beyond which little can be known."""
    initial_free_radius: Positive = 3.0
    """Metres around each start that are known to be free: the robot stands there."""
    speed: Positive = 2.0
    """Metres a second, in a straight line; see the argument `max_time`."""
    turn_rate: Positive = 1.0
    """Radians a second. A camera turns while it moves."""
    scan_time: NonNegative = 2.0
    """Seconds that a scan takes."""
    max_start_distance: Positive = 20.0
    """Metres: teammates start no further than this from the first robot. By default a depth of
    field."""
    crop_cells: Annotated[int, Bounds(at_least=4)] = 48
    """Side of the observed crop of the map, cells: the default depth of field lies inside."""

    def lattice_speeds(self, resolution: float) -> LatticeSpeeds:
        """How fast cameras move over a lattice with cells of this many metres."""
        return LatticeSpeeds(
            self.speed / resolution, self.turn_rate * self.n_headings / (2.0 * math.pi)
        )

    @classmethod
    def v0(cls) -> PlanarSettings:
        """The readings and constants of version v0 of the ids, to reproduce its results."""
        return cls(
            beam=BeamModel(),
            log_odds_range=LogOddsRange(),
            rating=PlanarRatingSettings(
                K=0.2, n_gray_bins=64, interpretation="literal", hidden="printed"
            ),
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
            speed=base.speed * resolution,
            initial_free_radius=base.initial_free_radius * resolution,
            max_start_distance=base.max_start_distance * resolution,
        )
