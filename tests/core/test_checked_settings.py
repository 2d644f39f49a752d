import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np
import pytest

from coopmap_env.core.settings import (
    Bounds,
    NonNegative,
    OpenUnitInterval,
    Positive,
    PositiveInt,
    Settings,
)


@dataclass(frozen=True)
class Lens(Settings):
    focal_length: Positive = 0.05


@dataclass(frozen=True)
class Camera(Settings):
    lens: Lens = field(default_factory=Lens)
    pixels: tuple[PositiveInt, PositiveInt] = (64, 48)
    distortion: tuple[float, ...] = ()
    noise: NonNegative = 0.0
    quality: OpenUnitInterval = 0.5
    tilt: Annotated[float, Bounds(at_least=-math.pi, below=math.pi)] = 0.0
    mode: Literal["gray", "color"] = "gray"
    gain: Positive | None = None
    is_on: bool = True


def test_values_inside_of_their_ranges_are_kept():
    camera = Camera(Lens(1), (1, 2), (0.1, -3), 0, np.float64(0.1), -math.pi, "color", 2.0, False)
    assert camera.pixels == (1, 2)
    assert camera.lens.focal_length == 1


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("lens", 3.0, "Lens"),
        ("pixels", (64, 0), "(an integer >= 1, an integer >= 1)"),
        ("pixels", (64, 48, 3), "(an integer >= 1, an integer >= 1)"),
        ("pixels", [64, 48], "(an integer >= 1, an integer >= 1)"),
        ("distortion", (0.1, math.nan), "a tuple, each a finite number"),
        ("noise", -0.1, "a finite number >= 0"),
        ("noise", math.inf, "a finite number >= 0"),
        ("noise", math.nan, "a finite number >= 0"),
        ("noise", "0.1", "a finite number >= 0"),
        ("noise", True, "a finite number >= 0"),
        ("quality", 1.0, "a finite number > 0 and < 1"),
        ("tilt", math.pi, "a finite number >= -3.14159 and < 3.14159"),
        ("mode", "grey", "one of 'gray', 'color'"),
        ("gain", 0.0, "a finite number > 0 or None"),
        ("is_on", 1, "bool"),
    ],
)
def test_the_message_names_class_field_expectation_and_value(name, value, expected):
    with pytest.raises(ValueError) as raised:  # noqa: PT011 - the whole message is compared
        Camera(**{name: value})
    assert str(raised.value) == f"Camera.{name} must be {expected}, got {value!r}"


def test_an_integer_is_no_boolean_and_no_fraction():
    for wrong in (True, 2.5, 2.0):
        with pytest.raises(ValueError, match="an integer >= 1"):
            Camera(pixels=(wrong, 2))
