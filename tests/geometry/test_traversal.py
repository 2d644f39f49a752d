"""Grid traversal: every crossed cell once, in order, and nothing else."""

import numpy as np
import pytest
from plain.ray_cells import crossed_cells

from coopmap_env.geometry import traverse


def cells(*args):
    return [tuple(cell) for cell in traverse(*args).cells.tolist()]


def random_rays(rng, shape, n):
    """Rays from anywhere in the grid, of any direction; lengths from a fraction to beyond it."""
    for _ in range(n):
        origin = rng.uniform(0, shape)
        yield origin, rng.normal(size=len(shape)), rng.uniform(0.1, 2 * max(shape))


def lattice_rays(rng, shape, n):
    """Rays that start on faces and corners, along axes and diagonals, where ties are the rule."""
    for _ in range(n):
        origin = np.array([rng.integers(0, size) for size in shape], dtype=float)
        origin += 0.5 * rng.integers(0, 2, len(shape))
        direction = np.zeros(len(shape))
        while not direction.any():
            direction = rng.integers(-2, 3, len(shape)).astype(float)
        yield origin, direction, float(rng.integers(1, 2 * max(shape)))


def test_a_ray_along_x_crosses_one_cell_per_unit_of_length():
    ray = traverse([0.5, 1.5], [1, 0], 2.0, (5, 3))
    assert ray.cells.tolist() == [[0, 1], [1, 1], [2, 1]]
    assert ray.entries.tolist() == [0.0, 0.5, 1.5]


def test_a_ray_against_y_counts_cells_downwards():
    ray = traverse([2.5, 2.75], [0, -1], 2.0, (5, 3))
    assert ray.cells.tolist() == [[2, 2], [2, 1], [2, 0]]
    assert ray.entries.tolist() == [0.0, 0.75, 1.75]


def test_a_slanted_ray_enters_cells_at_distances_computed_by_hand():
    # slope 3 : 4, unit direction (0.8, 0.6): faces x = 1, 2 at 0.625, 1.875; y = 1 at 5 / 6
    ray = traverse([0.5, 0.5], [4, 3], 2.0, (4, 4))
    assert ray.cells.tolist() == [[0, 0], [1, 0], [1, 1], [2, 1]]
    assert ray.entries == pytest.approx([0, 0.625, 5 / 6, 1.875])


def test_a_diagonal_goes_around_corners_through_the_cells_beside_them():
    """The cell beside a corner is listed with no length: a ray never jumps over a corner."""
    ray = traverse([0.5, 0.5], [1, 1], 2.5, (4, 4))
    assert ray.cells.tolist() == [[0, 0], [1, 0], [1, 1], [2, 1], [2, 2]]
    half = np.sqrt(0.5)
    assert ray.entries == pytest.approx([0, half, half, 3 * half, 3 * half])


def test_a_diagonal_in_three_dimensions_steps_over_one_face_at_a_time():
    ray = traverse([0.5, 0.5, 0.5], [1, 1, 1], 1.0, (3, 3, 3))
    assert ray.cells.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [1, 1, 1]]
    assert ray.entries == pytest.approx([0, *[np.sqrt(0.75)] * 3])


def test_a_ray_along_z_stays_in_its_column():
    assert cells([1.5, 0.5, 2.5], [0, 0, -1], 9.0, (2, 2, 3)) == [(1, 0, 2), (1, 0, 1), (1, 0, 0)]


def test_a_ray_that_starts_on_a_face_begins_in_the_cell_above_it():
    assert cells([2.0, 0.5], [1, 0], 1.5, (5, 1)) == [(2, 0), (3, 0)]


def test_a_ray_that_starts_on_a_face_and_goes_down_crosses_its_first_cell_with_no_length():
    ray = traverse([2.0, 0.5], [-1, 0], 1.5, (5, 1))
    assert ray.cells.tolist() == [[2, 0], [1, 0], [0, 0]]
    assert ray.entries.tolist() == [0.0, 0.0, 1.0]


def test_a_ray_out_of_the_lower_border_crosses_nothing():
    assert cells([0.0, 0.5], [-1, 0], 5.0, (5, 1)) == []


def test_a_ray_of_no_length_crosses_nothing():
    assert cells([0.5, 0.5], [1, 0], 0.0, (5, 1)) == []


def test_the_length_of_the_direction_does_not_matter():
    args = ([1.2, 0.7], 6.0, (8, 8))
    long, short = ([1e3 * u for u in (0.6, 0.7)], [1e-3 * u for u in (0.6, 0.7)])
    assert cells(args[0], long, *args[1:]) == cells(args[0], short, *args[1:])


@pytest.mark.parametrize("shape", [(9, 7), (1, 12), (6, 5, 4), (3, 1, 8)])
def test_traversal_finds_the_cells_that_clipping_against_every_cell_finds(shape):
    rng = np.random.default_rng(1)
    for origin, direction, length in random_rays(rng, shape, 150):
        ray = traverse(origin, direction, length, shape)
        plain = crossed_cells(origin, direction, length, shape)
        assert [tuple(cell) for cell in ray.cells] == [cell for cell, _, _ in plain]
        # sums of a dozen terms below 1e3 carry rounding errors below 1e-12 * 1e3
        assert ray.entries == pytest.approx([entry for _, entry, _ in plain], abs=1e-9)


@pytest.mark.parametrize("shape", [(9, 7), (6, 5, 4)])
def test_on_faces_and_corners_a_ray_adds_adjacent_cells_only(shape):
    rng = np.random.default_rng(2)
    for origin, direction, length in lattice_rays(rng, shape, 300):
        ray = traverse(origin, direction, length, shape)
        end = np.append(ray.entries, length)[1:] if len(ray.entries) else []
        crossed = {
            tuple(cell)
            for cell, entry, leave in zip(ray.cells, ray.entries, end, strict=True)
            if leave - entry > 1e-9
        }
        assert crossed == {cell for cell, _, _ in crossed_cells(origin, direction, length, shape)}


@pytest.mark.parametrize("shape", [(11, 8), (1, 1), (5, 7, 6)])
@pytest.mark.parametrize("rays", [random_rays, lattice_rays])
def test_a_ray_stays_in_the_grid_crosses_each_cell_once_and_steps_over_faces(shape, rays):
    for origin, direction, length in rays(np.random.default_rng(3), shape, 400):
        ray = traverse(origin, direction, length, shape)
        assert ((ray.cells >= 0) & (ray.cells < shape)).all()
        assert len(np.unique(ray.cells, axis=0)) == len(ray.cells)
        assert (np.abs(np.diff(ray.cells, axis=0)).sum(axis=1) == 1).all()
        assert (np.diff(ray.entries) >= 0).all()
        assert (ray.entries < length).all()


@pytest.mark.parametrize("shape", [(40, 25), (9, 12, 7)])
def test_a_long_ray_ends_in_a_cell_of_the_border(shape):
    for origin, direction, _ in random_rays(np.random.default_rng(4), shape, 300):
        last = traverse(origin, direction, 1e4, shape).cells[-1]
        outwards = np.where(np.asarray(direction) > 0, last == np.array(shape) - 1, last == 0)
        assert outwards.any()


@pytest.mark.parametrize("slope", [1e-12, 1e-300, 5e-324])
def test_a_ray_that_is_parallel_to_an_axis_but_for_rounding_stays_in_its_row(slope):
    for sign in (1, -1):
        for row in (0.5, 3.5):
            found = cells([0.5, row], [1, sign * slope], 99.0, (4, 4))
            assert found == [(x, int(row)) for x in range(4)]


def test_far_from_the_origin_of_a_large_grid_no_cell_is_lost():
    shape = (3000, 3000)
    for origin, direction, _ in random_rays(np.random.default_rng(5), shape, 50):
        ray = traverse(origin, direction, 1e5, shape)
        # between two faces the ray has moved by one cell per step: check with exact positions
        u = direction / np.linalg.norm(direction)
        middle = (ray.entries[:-1] + ray.entries[1:]) / 2
        wide = np.diff(ray.entries) > 1e-6
        positions = origin + middle[:, None] * u
        assert (np.floor(positions[wide]) == ray.cells[:-1][wide]).all()


@pytest.mark.parametrize(
    ("origin", "direction", "length", "shape", "message"),
    [
        ([0.5, 0.5, 0.5], [1, 0], 1.0, (2, 2), "do not fit"),
        ([0.5, 0.5], [1, 0, 0], 1.0, (2, 2), "do not fit"),
        ([0.5], [1], 1.0, (2,), "do not fit"),
        ([0.5, np.nan], [1, 0], 1.0, (2, 2), "finite"),
        ([0.5, 0.5], [np.inf, 0], 1.0, (2, 2), "finite"),
        ([0.5, 0.5], [1, 0], np.inf, (2, 2), "finite"),
        ([0.5, 0.5], [0, 0], 1.0, (2, 2), "finite"),
        ([-0.1, 0.5], [1, 0], 1.0, (2, 2), "outside"),
        ([0.5, 2.0], [1, 0], 1.0, (2, 2), "outside"),
    ],
)
def test_an_invalid_ray_is_rejected(origin, direction, length, shape, message):
    with pytest.raises(ValueError, match=message):
        traverse(origin, direction, length, shape)
