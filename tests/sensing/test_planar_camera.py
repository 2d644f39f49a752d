"""The fan of beams of a planar camera."""

import math

import numpy as np
import pytest

from coopmap_env.sensing import PlanarCamera


def test_three_beams_go_through_the_middle_of_thirds_of_the_field_of_view():
    camera = PlanarCamera(field_of_view=math.radians(90), n_beams=3)
    assert np.degrees(camera.bearings) == pytest.approx([-30, 0, 30])


def test_one_beam_goes_along_the_optical_axis():
    assert PlanarCamera(n_beams=1).bearings == pytest.approx([0])


def test_a_camera_that_sees_all_around_sends_no_beam_twice():
    bearings = PlanarCamera(field_of_view=2 * math.pi, n_beams=8).bearings
    assert np.degrees(bearings) == pytest.approx(-157.5 + 45 * np.arange(8))


@pytest.mark.parametrize("n_beams", [1, 2, 7, 64, 200])
def test_beams_are_symmetric_evenly_spaced_and_inside_the_field_of_view(n_beams):
    camera = PlanarCamera(field_of_view=1.2, n_beams=n_beams)
    assert len(camera.bearings) == n_beams
    assert camera.bearings == pytest.approx(-camera.bearings[::-1], abs=1e-15)
    assert np.diff(camera.bearings) == pytest.approx(np.full(n_beams - 1, 1.2 / n_beams))
    assert np.abs(camera.bearings).max() < 0.6


def test_at_the_end_of_the_default_view_neighbouring_beams_are_less_than_a_metre_apart():
    camera = PlanarCamera()
    assert camera.depth_of_field * camera.field_of_view / camera.n_beams < 1.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("field_of_view", 0.0),
        ("field_of_view", 6.3),
        ("field_of_view", math.nan),
        ("depth_of_field", 0.0),
        ("depth_of_field", math.inf),
        ("depth_of_field", math.nan),
        ("n_beams", 0),
    ],
)
def test_a_camera_without_a_view_is_rejected(name, value):
    with pytest.raises(ValueError, match=rf"PlanarCamera\.{name} .*{value}"):
        PlanarCamera(**{name: value})
