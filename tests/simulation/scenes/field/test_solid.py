import numpy as np
import pytest

from coopmap_env.geometry import random_rotation
from coopmap_env.simulation.scenes.field._voxel_truth import is_closed
from coopmap_env.simulation.scenes.field.solid import (
    Solid,
    box_corners,
    convex_hull,
    ground_slab,
    solid_from_boxes,
    solid_from_hull,
)

TETRAHEDRON = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])


def volume(solid):
    a, b, c = np.moveaxis(solid.triangles, 1, 0)
    return np.einsum("mk,mk->m", a, np.cross(b, c)).sum() / 6


def test_a_solid_keeps_read_only_copies():
    vertices = TETRAHEDRON.copy()
    solid = Solid("t", vertices, FACES)
    vertices[0] = 9.0
    np.testing.assert_array_equal(solid.vertices, TETRAHEDRON)
    for array in (solid.vertices, solid.faces, solid.triangles):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0


def test_without_hulls_all_vertices_are_one_part():
    solid = Solid("t", TETRAHEDRON, FACES)
    assert len(solid.parts) == 1
    np.testing.assert_array_equal(solid.parts[0], TETRAHEDRON)
    np.testing.assert_array_equal(solid.bounds, [[0, 0, 0], [1, 1, 1]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"vertices": np.zeros((4, 2))}, r"vertices of 't' must have shape.*\(4, 2\)"),
        ({"vertices": np.full((4, 3), np.nan)}, "vertices of 't' must be finite, not nan"),
        ({"faces": np.zeros((0, 3), int)}, r"faces of 't' must have shape \(f, 3\)"),
        ({"vertices": [[0, 0, 0], [1, 0]]}, "vertices of 't' must be numbers"),
        ({"vertices": "abc"}, "vertices of 't' must be numbers"),
        ({"vertices": None}, "vertices of 't' must have shape"),
        ({"faces": [[0, 1, 2], [0]]}, "faces of 't' must have shape"),
        ({"faces": FACES + 1}, "must name vertices 0 to 3, not 1 to 4"),
        ({"faces": FACES * 1.0}, "integers, not float64"),
        ({"hulls": (np.zeros((3, 3)),)}, "a hull of 't'"),
        ({"hulls": (TETRAHEDRON,), "is_concave": True}, "concave and has 1 hulls"),
        ({"is_target": True, "is_ground": True}, "target and ground"),
    ],
)
def test_a_broken_solid_says_what_is_wrong(change, message):
    fields = {"name": "t", "vertices": TETRAHEDRON, "faces": FACES, **change}
    with pytest.raises(ValueError, match=message):
        Solid(**fields)


def test_a_box_is_closed_and_its_faces_point_outwards():
    rotation = random_rotation(np.random.default_rng(0))
    box = solid_from_boxes("b", [box_corners((1, 2, 3), (4, 5, 6), rotation)])
    assert len(box.faces) == 12
    assert is_closed(box.faces)
    assert volume(box) == pytest.approx(6.0)
    np.testing.assert_allclose(box.vertices.mean(axis=0), (4, 5, 6))


def test_a_hull_is_closed_and_its_faces_point_outwards():
    points = np.random.default_rng(0).normal(size=(40, 3))
    solid = solid_from_hull("h", points)
    from scipy.spatial import ConvexHull

    assert is_closed(solid.faces)
    assert volume(solid) == pytest.approx(ConvexHull(points).volume)
    assert len(solid.vertices) == len(ConvexHull(points).vertices)


def test_points_in_one_plane_span_no_hull():
    with pytest.raises(ValueError, match="5 points span no convex hull"):
        convex_hull(np.random.default_rng(0).random((5, 3)) * [1, 1, 0])


def test_ground_ends_at_z_0():
    slab = ground_slab((-1, -2), (3, 4), 0.5)
    assert slab.is_ground
    np.testing.assert_allclose(slab.bounds, [[-1, -2, -0.5], [3, 4, 0]])
