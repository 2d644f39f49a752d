"""Settings of the correction of camera poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    NonNegativeInt,
    Positive,
    PositiveInt,
    Settings,
)


@dataclass(frozen=True)
class CorrectionSettings(Settings):
    """How scans are compared with earlier ones and with the known target."""

    prior: Literal["kinematic", "encoders"] = "kinematic"
    """The camera pose that fiducials correct: by kinematics with the predicted deflection of the
    suspension, whose stiffness is then estimated too, or with the suspension assumed at rest."""
    smoothing: bool = True
    """Whether later scans revise the poses of earlier ones, and the map is made again of the
    revised scans."""
    min_revision: NonNegative = 0.005
    """Metres by which a point at 3 m of some scan moves before the map is made again: a smaller
    change is not worth the time, for voxels are much larger."""
    min_fiducials: PositiveInt = 3
    """With fewer, the pose stays as predicted."""
    min_patch_pixels: PositiveInt = 3
    """Least pixels of a patch that counts. With 6, as in v0, the median position error on 16
    training worksites is 2.42 mm instead of 2.35, and a twentieth less scans are corrected."""
    patch_model_std: NonNegative = 0.0005
    """Metres by which a patch may be off for other reasons than its pixels' noise: surfaces are
    sampled by pixels, and normals differ a little inside of a patch. Of 0, 0.5 and 1 mm the one
    with which covariances come closest to the errors on 24 training worksites."""
    tilt_noise_factor: NonNegative = 4.0
    """Times the variance of normals: a direction with less information than this, relative to the
    patch's best direction, is an effect of noise in the normals, and is left out."""
    outlier_sigmas: Positive = 4.0
    """Standard deviations beyond which a patch is an outlier: something moved, or is another."""
    outlier_std: NonNegative = 0.003
    """Metres, added to a patch's deviation in the test for outliers. A large thing that moved by a
    few centimetres may pass, and moves the pose by some millimetres."""
    max_keyframes: Annotated[int, Bounds(at_least=1, largest=10_000)] = 32
    """Earlier scans that are kept for comparison; the oldest is dropped first."""
    min_planar_pixels: NonNegativeInt = 40
    """Pixels with a normal that an earlier scan needs to be kept."""
    max_sources: PositiveInt = 4
    """Earlier scans that a scan is compared with: those with the largest overlap."""
    max_association_distance: Positive = 0.25
    """Metres between a point and the surface that it may belong to."""
    target_spacing: Annotated[float, Bounds(above=0, smallest=0.01)] = 0.4
    """Metres between the fiducials on the known target."""
    iterations: Annotated[int, Bounds(at_least=1, largest=1_000)] = 5
    """Rounds of associating pixels and solving; the last ones move the camera by less than 0.1
    mm."""
