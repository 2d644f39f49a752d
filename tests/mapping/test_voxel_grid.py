"""Between metric points and cell indices."""

import math

import numpy as np
import pytest

from coopmap_env.mapping import VoxelGrid


def test_points_cells_and_centers_by_hand():
    grid = VoxelGrid((4, 3), resolution=0.5, origin=(-1.0, 10.0))
    assert grid.to_cell_units([0.25, 10.5]) == pytest.approx([2.5, 1.0])
    assert grid.index([[0.25, 10.5], [-1.0, 11.49], [-1.1, 9.9]]).tolist() == [
        [2, 1],
        [0, 2],
        [-1, -1],
    ]
    assert grid.center([2, 1]) == pytest.approx([0.25, 10.75])
    assert grid.flat_index([[2, 1], [3, 2]]).tolist() == [7, 11]
    assert grid.contains([[0, 0], [3, 2], [4, 0], [0, -1]]).tolist() == [True, True, False, False]


def test_a_planar_grid_is_one_layer_for_kernels():
    assert VoxelGrid((4, 3)).shape_3d == (4, 3, 1)
    assert VoxelGrid((4, 3, 2)).shape_3d == (4, 3, 2)


@pytest.mark.parametrize("shape", [(5, 7), (3, 4, 5)])
def test_every_cell_is_found_again_by_its_center_and_its_flat_number(shape):
    grid = VoxelGrid(shape, resolution=0.1, origin=(0.3,) * len(shape))
    index = np.argwhere(np.ones(shape))
    assert grid.n_cells == len(index)
    assert (grid.index(grid.center(index)) == index).all()
    assert grid.contains(index).all()
    assert grid.flat_index(index).tolist() == list(range(grid.n_cells))


def test_a_cell_outside_has_no_flat_number():
    with pytest.raises(ValueError, match="invalid entry"):
        VoxelGrid((4, 3)).flat_index([4, 0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"shape": (4,)}, "shape"),
        ({"shape": (4, 4, 4, 4)}, "shape"),
        ({"shape": (4, 0)}, "shape"),
        ({"shape": (4, 2.5)}, "shape"),
        ({"shape": ("4", 4)}, "shape"),
        ({"shape": (5000, 5000, 5000)}, r"shape .*125,000,000,000 cells, .*COOPMAP_MAX_CELLS"),
        ({"shape": (10**30, 1)}, r"shape .*over 10\*\*15 cells"),
        ({"shape": (4, 4), "resolution": 0.0}, "resolution"),
        ({"shape": (4, 4), "resolution": "fine"}, "resolution"),
        ({"shape": (4, 4), "resolution": 10**400}, "resolution"),
        ({"shape": (4, 4), "resolution": math.nan}, "resolution"),
        ({"shape": (4, 4), "origin": (0.0,)}, "origin"),
        ({"shape": (4, 4), "origin": (0.0, math.inf)}, "origin"),
        ({"shape": (4, 4), "origin": (0.0, None)}, "origin"),
    ],
)
def test_an_invalid_grid_is_rejected(arguments, message):
    with pytest.raises(ValueError, match=rf"VoxelGrid\.{message}"):
        VoxelGrid(**arguments)


def test_a_grid_takes_the_integers_and_arrays_of_numpy():
    grid = VoxelGrid((np.int32(4), np.uint8(3)), np.float32(0.5), np.array([1.0, 2.0]))
    assert grid == VoxelGrid((4, 3), 0.5, (1.0, 2.0))
    assert [type(n) for n in grid.shape] == [int, int]
