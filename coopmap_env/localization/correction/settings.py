"""Constants of motion correction, in metres and radians."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields


@dataclass(frozen=True)
class CorrectionSettings:
    """How looks are held against earlier ones and against the known target.

    Raises
    ------
    ValueError
        With the value, if one is out of its range.
    """

    min_fiducials: int = 3
    """Fewer of them say nothing that is sure enough: the prediction stays."""
    min_patch_pixels: int = 6
    """Of a patch that counts: of fewer, one wrong pixel decides."""
    patch_model_std: float = 0.0005
    """Metres by which a patch may lie off for other reasons than its pixels' noise: surfaces are
    sampled by pixels, and normals differ a little inside of a patch. Of 0, 0.5 and 1 mm the one
    with which claimed covariances come closest to the errors on 24 training worksites."""
    tilt_noise_factor: float = 4.0
    """Times the variance of normals: information of a patch that is less than this, against its
    best direction, is taken for what noise in the normals makes up, and left out."""
    outlier_sigmas: float = 4.0
    """A patch that lies further from where all others put it has moved, or is something else."""
    outlier_std: float = 0.003
    """Metres: added to a patch's deviation before it is called an outlier. A large thing that moved
    by a few centimetres may pass, and drags the pose by some millimetres."""
    max_keyframes: int = 32
    """Earlier looks that are kept to be held against; the oldest are forgotten first."""
    max_sources: int = 4
    """Earlier looks, those with the most pixels in common, that a look is held against."""
    target_spacing: float = 0.4
    """Metres between the fiducials on the known target."""
    iterations: int = 5
    """Of associating pixels and solving; the last ones move the camera by less than 0.1 mm."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            is_number = isinstance(value, int | float) and not isinstance(value, bool)
            if not is_number or not math.isfinite(value) or value < 0:
                raise ValueError(
                    f"CorrectionSettings.{field.name} must be finite and >= 0, got {value!r}"
                )
            if field.type == "int" and not (isinstance(value, int) and value >= 1):
                raise ValueError(
                    f"CorrectionSettings.{field.name} must be a whole number >= 1, got {value!r}"
                )
        for name in ("target_spacing", "outlier_sigmas"):
            if getattr(self, name) == 0:
                raise ValueError(f"CorrectionSettings.{name} must be > 0, got 0")
