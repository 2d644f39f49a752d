"""Springs between the wheels of a stationary vehicle and its body."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

SUSPENSION_JOINTS = ("suspension_heave", "suspension_roll", "suspension_pitch")
"""The joints that every mount's URDF has between its base and its body, from the wheels up."""


@dataclass(frozen=True)
class Suspension:
    """Linear springs and dampers of a body's heave, roll and pitch about its roll centre.

    The springs are preloaded: with the mount at home the deflections are zero. A moment M of the
    moving mount turns the body by about M / stiffness; its weight is the same in every posture, so
    heave moves only while the mount is accelerating.

    Raises
    ------
    ValueError
        If a value is negative or not finite, or a stiffness is zero.
    """

    heave_stiffness: float = 60_000.0
    """N/m: 145 kg bounce at 3.2 Hz, as on the stiff springs of a work vehicle."""
    roll_stiffness: float = 9_000.0
    """N m/rad: a mast swung out sideways (about 100 N m) leans the body by half a degree."""
    pitch_stiffness: float = 12_000.0
    """N m/rad: the wheelbase is longer than the track."""
    heave_damping: float = 4_100.0
    """N s/m: 0.7 of the critical damping of the mast's 145 kg."""
    roll_damping: float = 820.0
    """N m s/rad: 0.7 of the critical damping of the mast's 38 kg m^2 about the roll centre."""
    pitch_damping: float = 1_000.0
    """N m s/rad: 0.7 of the critical damping of the mast's 43 kg m^2."""
    roll_center_height: float = 0.25
    """Metres above ground, of the axes of roll and pitch."""
    heave_std: float = 0.0002
    """Metres: what the robot, which measures no deflection, ascribes to heave: at rest its weight
    is the same in every posture."""
    roll_std: float = 0.0045
    """Radians (a quarter of a degree), ascribed to roll: its root mean square over the poses of the
    mast, and so are the others."""
    pitch_std: float = 0.0036
    """Radians, ascribed to pitch."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value >= 0):
                raise ValueError(f"Suspension.{field.name} must be finite and >= 0, got {value}")
            if field.name.endswith("stiffness") and value == 0:
                raise ValueError(f"Suspension.{field.name} must be > 0, got {value}")

    @property
    def stiffness(self) -> tuple[float, float, float]:
        """Of heave, roll and pitch, in the order of `SUSPENSION_JOINTS`."""
        return self.heave_stiffness, self.roll_stiffness, self.pitch_stiffness

    @property
    def damping(self) -> tuple[float, float, float]:
        """Of heave, roll and pitch."""
        return self.heave_damping, self.roll_damping, self.pitch_damping

    @property
    def std(self) -> tuple[float, float, float]:
        """Standard deviations that a robot ascribes to heave, roll and pitch."""
        return self.heave_std, self.roll_std, self.pitch_std
