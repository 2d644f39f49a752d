import numpy as np
import pytest
from plain.triangle_camera import box

from coopmap_env.localization.target import TargetModel


def degrees(model):
    return [
        round(np.degrees(np.arctan2(m.rotation[1, 0], m.rotation[0, 0]))) for m in model.symmetries
    ]


def test_a_cube_is_symmetric_by_quarter_turns():
    assert degrees(TargetModel(box((1, 1, 1), (0, 0, 0.5)))) == [0, 90, 180, -90]


def test_an_oblong_box_is_symmetric_by_a_half_turn_about_its_own_center():
    model = TargetModel(box((2, 1, 1), (3, 1, 0.5)))
    assert degrees(model) == [0, 180]
    moved = model.symmetries[1].transform([3.0, 1.0, 0.2])
    np.testing.assert_allclose(moved, [3.0, 1.0, 0.2], atol=0.02)  # samples are 4 cm apart


def test_a_box_with_a_lug_on_one_side_has_but_the_identity():
    model = TargetModel(
        np.concatenate([box((2, 1, 1), (0, 0, 0.5)), box((0.3,) * 3, (1.1, 0, 0.5))])
    )
    assert degrees(model) == [0]
    np.testing.assert_array_equal(model.symmetries[0].rotation, np.eye(3))


def test_the_worksites_panel_has_but_the_identity():
    from coopmap_env.simulation.scenes.field import target_solids

    assert degrees(TargetModel(target_solids()[0].triangles)) == [0]


def test_samples_lie_on_the_faces_and_share_them_by_area():
    """A box of 2 x 1 x 1 m has 10 square metres, 2 of them on top."""
    model = TargetModel(box((2, 1, 1), (0, 0, 0.5)), spacing=0.05)
    points, normals = model.samples
    assert model.area == pytest.approx(10.0)
    assert len(points) == len(normals) == 4000  # 10 / 0.05^2
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    top = normals[:, 2] > 0.5
    assert top.mean() == pytest.approx(0.2, abs=1e-3)
    np.testing.assert_allclose(points[top, 2], 1.0)
    # outward: from the middle, every face is seen from behind
    assert (np.einsum("ni,ni->n", points - [0, 0, 0.5], normals) > 0).all()
    # evenly: no two square decimetres of the top differ by more than a few samples of 4
    counts = np.histogram2d(*points[top, :2].T, bins=(20, 10), range=((-1, 1), (-0.5, 0.5)))[0]
    assert counts.min() >= 1
    assert counts.max() <= 8


def test_triangles_without_an_area_are_left_out():
    flat = np.zeros((1, 3, 3))
    model = TargetModel(np.concatenate([flat, box((1, 1, 1), (0, 0, 0.5))]))
    assert len(model.triangles) == 12


@pytest.mark.parametrize(
    "triangles",
    [np.zeros((0, 3, 3)), np.zeros((4, 3)), np.zeros((2, 3, 3)), np.full((1, 3, 3), np.nan)],
)
def test_what_is_no_surface_is_rejected(triangles):
    with pytest.raises(ValueError, match="triangles"):
        TargetModel(triangles)


def test_a_spacing_that_is_no_length_is_rejected_with_its_value():
    with pytest.raises(ValueError, match="spacing must be finite and > 0, got -1"):
        TargetModel(box((1, 1, 1), (0, 0, 0.5)), spacing=-1)


def test_a_target_of_square_kilometres_is_refused_before_its_samples_are_made():
    model = TargetModel([[[0, 0, 0], [2000, 0, 0], [0, 2000, 0]]])
    with pytest.raises(
        ValueError, match=r"samples 0\.04 m apart of a target with 2e\+06 m2.*limit"
    ):
        model.samples  # noqa: B018
