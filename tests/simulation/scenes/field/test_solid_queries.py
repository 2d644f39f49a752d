import numpy as np
import pytest
from plain import solids as plain

from coopmap_env.simulation.scenes.field._solid_queries import (
    distance_to_axis,
    distance_to_triangles,
    first_hit,
)
from coopmap_env.simulation.scenes.field.solid import (
    box_corners,
    ground_slab,
    solid_from_boxes,
    solid_from_hull,
)


def box(name, size, center):
    return solid_from_boxes(name, [box_corners(size, center)])


def test_first_hit_agrees_with_solving_for_each_triangle():
    rng = np.random.default_rng(0)
    solids = [
        solid_from_hull(f"{k}", 0.5 * rng.normal(size=(10, 3)) + rng.uniform(-3, 3, 3))
        for k in range(12)
    ]
    for _ in range(5):
        eye, points = rng.uniform(-4, 4, 3), rng.uniform(-3, 3, (40, 3))
        hits = first_hit(eye, points, solids)
        np.testing.assert_array_equal(hits, plain.first_hit(eye, points, solids))
    assert (hits >= 0).any()


def test_the_nearer_of_two_boxes_is_hit_and_a_ray_past_them_hits_nothing():
    solids = [box("far", (1, 1, 1), (5, 0, 0)), box("near", (1, 1, 1), (3, 0, 0))]
    points = np.array([[1.0, 0.01, 0.02], [-1.0, 0.0, 0.0], [3.0, 0.9, 0.0]])
    assert first_hit(np.zeros(3), points, solids).tolist() == [1, -1, -1]
    assert first_hit(np.array([10.0, 0.01, 0.02]), points[:1], solids).tolist() == [0]


def test_distances_in_the_plane_agree_with_points_along_edges():
    rng = np.random.default_rng(1)
    for _ in range(30):
        triangles, point = rng.normal(size=(4, 3, 2)), 2 * rng.normal(size=2)
        expected = plain.planar_distance(point, triangles)
        # the reference's points lie up to 0.004 m apart along an edge
        assert distance_to_triangles(*point, triangles) == pytest.approx(expected, abs=4e-3)


def test_an_axis_has_a_distance_from_solids_at_any_height_but_not_from_ground():
    roof = box("roof", (2, 2, 0.1), (0, 0, 3))
    slab = ground_slab((-9, -9), (9, 9))
    assert distance_to_axis((4.0, 0.0), [roof, slab]) == pytest.approx(3.0)
    assert distance_to_axis((4.0, 5.0), [roof, slab]) == pytest.approx(5.0)
    assert distance_to_axis((0.3, 0.2), [roof, slab]) == 0.0
    assert distance_to_axis((0.0, 0.0), [slab]) == np.inf
