import numpy as np
import pytest
from plain import solids as plain

from coopmap_env.geometry import random_rotation
from coopmap_env.mapping import VoxelGrid
from coopmap_env.simulation.scenes.field._voxel_truth import (
    is_closed,
    mark_surface_voxels,
    voxelize_solids,
    winding_numbers,
)
from coopmap_env.simulation.scenes.field.solid import (
    Solid,
    box_corners,
    solid_from_boxes,
    solid_from_hull,
)

UNIT = VoxelGrid((10, 10, 10), 1.0, (0.0, 0.0, 0.0))


def surface_voxels(triangles, grid):
    """Mask of the voxels that triangles (m, 3, 3) in metres intersect."""
    occupied = np.zeros(grid.shape, dtype=bool)
    mark_surface_voxels(np.ascontiguousarray(grid.to_cell_units(triangles)), occupied)
    return occupied


def box(low, high, name="box"):
    low, high = np.array(low, dtype=float), np.array(high, dtype=float)
    return solid_from_boxes(name, [box_corners(high - low, (low + high) / 2)])


def test_the_kernel_agrees_with_cutting_triangles_by_the_planes_of_voxels():
    rng = np.random.default_rng(0)
    grid = VoxelGrid((6, 5, 4), 1.0, (0.0, 0.0, 0.0))
    for size in (0.3, 1.0, 4.0):
        for _ in range(12):
            triangle = rng.random((1, 1, 3)) * grid.shape + size * rng.normal(size=(1, 3, 3))
            expected = plain.surface_voxels(triangle, grid.shape)
            np.testing.assert_array_equal(surface_voxels(triangle, grid), expected)


def test_no_point_of_a_surface_lies_outside_of_the_marked_voxels():
    rng = np.random.default_rng(1)
    grid = VoxelGrid((40, 40, 40), 0.05, (-1.0, -1.0, -1.0))
    triangles = rng.uniform(-0.9, 0.9, (20, 3, 3))
    occupied = surface_voxels(triangles, grid)
    index = grid.index(plain.sample_triangles(triangles, 30_000, rng))
    assert occupied[tuple(index.T)].all()
    # points less than 0.01 m apart miss only voxels of which a triangle cuts a corner
    hit = np.zeros_like(occupied)
    hit[tuple(index.T)] = True
    assert hit.sum() > 0.95 * occupied.sum()


def test_a_triangle_in_one_voxel_marks_this_one():
    triangle = np.array([[[2.2, 3.2, 4.2], [2.8, 3.2, 4.5], [2.2, 3.7, 4.8]]])
    np.testing.assert_array_equal(np.argwhere(surface_voxels(triangle, UNIT)), [[2, 3, 4]])


def test_a_thin_diagonal_plate_marks_the_voxels_along_the_diagonal_only():
    # x = y over the grid: 10 voxels of a layer, and those that it touches along their edges
    triangles = np.array([[[0, 0, 4.3], [10, 10, 4.3], [10, 10, 4.6]]], dtype=float)
    i, j, k = np.argwhere(surface_voxels(triangles, UNIT)).T
    assert set(k) == {4}
    assert np.abs(i - j).max() == 1
    assert (i == j).sum() == 10


def test_what_a_face_merely_touches_counts():
    occupied = surface_voxels(np.array([[[1.2, 1.2, 5], [1.8, 1.2, 5], [1.2, 1.8, 5]]]), UNIT)
    np.testing.assert_array_equal(np.argwhere(occupied), [[1, 1, 4], [1, 1, 5]])


def test_triangles_far_outside_mark_nothing():
    far = 1e300 * np.array([[[1, 1, 1], [2, 1, 1], [1, 2, 1]]], dtype=float)
    for triangles in (far, -far, far / 1e290):
        assert not surface_voxels(triangles, UNIT).any()


def test_the_inside_of_a_closed_box_is_filled_and_an_open_one_is_not():
    closed = box((1.5, 1.5, 1.5), (7.5, 6.5, 5.5))
    assert voxelize_solids([closed], UNIT).sum() == 7 * 6 * 5
    opened = Solid("open", closed.vertices, closed.faces[1:])
    assert not is_closed(opened.faces)
    assert not voxelize_solids([opened], UNIT)[4, 4, 3]


def test_a_box_that_sticks_out_of_the_grid_is_filled_up_to_its_border():
    occupied = voxelize_solids([box((-5, -5, -5), (20, 20, 3.5))], UNIT)
    assert occupied[:, :, :4].all()
    assert not occupied[:, :, 4:].any()
    assert voxelize_solids([box((-5, -5, -5), (20, 20, 20))], UNIT).all()
    assert not voxelize_solids([box((20, 20, 20), (30, 30, 30))], UNIT).any()


def test_a_hollow_between_boxes_stays_free():
    # six plates around a closed chamber: the plates are solid, the chamber is not inside of one
    low, high = 1.2, 8.8
    plates = []
    for axis in range(3):
        for at in (low, high):
            size, middle = np.full(3, high - low + 0.2), np.full(3, 5.0)
            size[axis], middle[axis] = 0.2, at
            plates.append(box_corners(size, middle))
    occupied = voxelize_solids([solid_from_boxes("chamber", plates)], UNIT)
    assert occupied[1:9, 1:9, 1:9].sum() == 8**3 - 6**3
    assert not occupied[2:8, 2:8, 2:8].any()


def test_overlapping_boxes_of_one_solid_are_filled_together():
    corners = [box_corners((4.0, 4, 4), (4.5, 4.5, 4.5)), box_corners((4.0, 4, 4), (5.5, 5.5, 5.5))]
    occupied = voxelize_solids([solid_from_boxes("two", corners)], UNIT)
    assert occupied[2:7, 2:7, 2:7].all()
    assert occupied[3:8, 3:8, 3:8].all()


def test_rotated_solids_hold_the_voxels_whose_center_they_hold():
    rng = np.random.default_rng(2)
    grid = VoxelGrid((30, 30, 30), 0.1, (-1.5, -1.5, -1.5))
    centers = grid.center(np.stack(np.indices(grid.shape), axis=-1))
    for _ in range(5):
        rotation = random_rotation(rng)
        solid = solid_from_boxes("b", [box_corners((1.7, 0.9, 1.3), (0.1, 0, 0), rotation)])
        local = np.abs((centers - [0.1, 0, 0]) @ rotation)
        inside = (local <= np.array([1.7, 0.9, 1.3]) / 2).all(axis=-1)
        reached = (local <= np.array([1.7, 0.9, 1.3]) / 2 + 0.0867).all(axis=-1)
        occupied = voxelize_solids([solid], grid)
        assert occupied[inside].all()
        assert not occupied[~reached].any()  # half the diagonal of a voxel is 0.0866 m


def test_winding_numbers_by_hand():
    two = solid_from_boxes(
        "t", [box_corners((2, 2, 2), (0, 0, 0)), box_corners((2, 2, 2), (1, 0, 0))]
    )
    points = np.array([[0.5, 0, 0], [-0.5, 0, 0], [1.5, 0.1, 0], [3.0, 0, 0]])
    np.testing.assert_allclose(winding_numbers(two.triangles, points), [2, 1, 1, 0], atol=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_a_closed_surface_is_closed_until_a_face_is_removed_or_reversed(seed):
    solid = solid_from_hull("h", np.random.default_rng(seed).normal(size=(20, 3)))
    assert is_closed(solid.faces)
    assert not is_closed(solid.faces[1:])
    turned = solid.faces.copy()
    turned[0] = turned[0, ::-1]
    assert not is_closed(turned)
