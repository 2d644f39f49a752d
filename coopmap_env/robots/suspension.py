"""Springs between the wheels of a stationary vehicle and its body."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated

from coopmap_env.core.settings import Bounds, NonNegative, Positive, Settings

SUSPENSION_JOINTS = ("suspension_heave", "suspension_roll", "suspension_pitch")
"""The joints that every mount's URDF has between its base and its body, from the wheels up."""


@dataclass(frozen=True)
class Suspension(Settings):
    """Linear springs and dampers of a body's heave, roll and pitch about its roll center.

    The springs are preloaded: with the mount at home the deflections are zero. A moment M of the
    moving mount turns the body by about M / stiffness; its weight is the same in every posture, so
    heave moves only while the mount is accelerating.

    Raises
    ------
    ValueError
        If a value is negative or not finite, or a stiffness is zero.
    """

    heave_stiffness: Positive = 60_000.0
    """N/m: 145 kg bounce at 3.2 Hz, as on the stiff springs of a work vehicle."""
    roll_stiffness: Positive = 9_000.0
    """N m/rad: a mast swung out sideways (about 100 N m) leans the body by half a degree."""
    pitch_stiffness: Positive = 12_000.0
    """N m/rad: the wheelbase is longer than the track."""
    heave_damping: NonNegative = 4_100.0
    """N s/m: 0.7 of the critical damping of the mast's 145 kg."""
    roll_damping: NonNegative = 820.0
    """N m s/rad: 0.7 of the critical damping of the mast's 38 kg m^2 about the roll center."""
    pitch_damping: NonNegative = 1_000.0
    """N m s/rad: 0.7 of the critical damping of the mast's 43 kg m^2."""
    roll_center_height: NonNegative = 0.25
    """Metres above ground, of the axes of roll and pitch."""
    heave_std: NonNegative = 0.0002
    """Metres: what the robot, which measures no deflection, assumes for heave. At rest its weight
    is the same in every posture."""
    roll_std: NonNegative = 0.0045
    """Radians (a quarter of a degree): what a robot that does not predict its deflection assumes
    for roll. Its root mean square over the poses of the mast; the others are alike."""
    pitch_std: NonNegative = 0.0036
    """Radians, likewise for pitch."""
    stiffness_tolerance: Annotated[float, Bounds(at_least=0, below=1)] = 0.2
    """Largest fraction by which the true stiffness of roll and pitch differs from the values above:
    springs and tires are known that well. A robot that predicts its deflection allows for it."""
    prediction_std: NonNegative = 0.00005
    """Metres of heave, radians of roll and pitch, by which a prediction is off besides: in stepped
    physics a body at rest still moves by as much."""

    @property
    def stiffness(self) -> tuple[float, float, float]:
        """Stiffness of heave, roll and pitch, in the order of `SUSPENSION_JOINTS`."""
        return self.heave_stiffness, self.roll_stiffness, self.pitch_stiffness

    @property
    def damping(self) -> tuple[float, float, float]:
        """Damping of heave, roll and pitch."""
        return self.heave_damping, self.roll_damping, self.pitch_damping

    @property
    def compliance_std(self) -> float:
        """Standard deviation of the compliance of roll and of pitch, relative, of a uniform error.

        Both inverses of a stiffness and the stiffness itself differ by about the same fraction.
        """
        return self.stiffness_tolerance / math.sqrt(3.0)

    @property
    def predicted_std(self) -> tuple[float, float, float]:
        """Standard deviations of heave, roll and pitch as predicted, if the stiffness is known."""
        return (self.prediction_std,) * 3

    @property
    def std(self) -> tuple[float, float, float]:
        """Standard deviations that a robot without a prediction assumes for heave, roll, pitch."""
        return self.heave_std, self.roll_std, self.pitch_std
