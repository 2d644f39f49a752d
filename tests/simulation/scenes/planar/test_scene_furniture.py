import numpy as np

from coopmap_env.simulation.scenes.planar import Rooms
from coopmap_env.simulation.scenes.planar.rooms import place_furniture


def plain_place_furniture(occupied, reserved, pieces, aisle):
    """Look at each cell of each piece."""
    cells = np.stack(np.indices(occupied.shape), axis=-1)
    for x, y, n_x, n_y in pieces:
        lower, upper = np.array([x, y]), np.array([x + n_x, y + n_y])
        piece = ((cells >= lower) & (cells < upper)).all(axis=-1)
        if not (piece & reserved).any():
            occupied |= piece
            reserved |= ((cells >= lower - aisle) & (cells < upper + aisle)).all(axis=-1)


def test_a_piece_that_reaches_into_an_aisle_is_left_out():
    occupied, reserved = np.zeros((2, 10, 12), dtype=bool)
    pieces = np.array([[0, 0, 2, 3], [3, 0, 1, 1], [4, 0, 1, 1]])
    place_furniture(occupied, reserved, pieces, 2)
    expected = np.zeros((10, 12), dtype=bool)
    expected[0:2, 0:3] = expected[4, 0] = True
    np.testing.assert_array_equal(occupied, expected)


def test_the_kernel_places_as_the_plain_check_of_each_cell():
    rng = np.random.default_rng(0)
    for aisle in (1, 2, 4):
        lower, sides = rng.integers(0, 25, (80, 2)), rng.integers(1, 6, (80, 2))
        doors = rng.random((30, 30)) < 0.02
        grids = [(np.zeros((30, 30), dtype=bool), doors.copy()) for _ in range(2)]
        place_furniture(*grids[0], np.hstack([lower, sides]), aisle)
        plain_place_furniture(*grids[1], np.hstack([lower, sides]), aisle)
        np.testing.assert_array_equal(grids[0], grids[1])
        assert grids[0][0].any()


def test_tried_pieces_lie_in_their_room_with_an_aisle_to_the_walls_opposite():
    scene = Rooms(resolution=0.2, aisle=0.8, furniture=1.0)  # an aisle is 4 cells
    rooms = np.array([[5, 7, 30, 25], [50, 60, 15, 40]])
    pieces = scene._random_furniture(np.random.default_rng(0), rooms)
    assert len(pieces) > 30
    in_first = pieces[:, 0] < 50
    assert 0 < np.count_nonzero(in_first) < len(pieces)
    room = np.where(in_first[:, None], rooms[0], rooms[1])
    before = pieces[:, :2] - room[:, :2]
    after = room[:, :2] + room[:, 2:] - pieces[:, :2] - pieces[:, 2:]
    assert (np.minimum(before, after) >= 0).all()
    assert (np.maximum(before, after) >= 4).all()
    in_between = np.minimum(before, after) > 0
    assert (np.minimum(before, after)[in_between] >= 4).all()
    for fraction in (before == 0, after == 0, in_between):
        assert fraction.any()
    # Sides of 0.4 m to 2 m.
    assert pieces[:, 2:].min() >= 2
    assert pieces[:, 2:].max() <= 10


def test_rooms_without_area_for_furniture_get_none():
    assert Rooms()._random_furniture(np.random.default_rng(0), np.empty((0, 4), int)).shape == (
        0,
        4,
    )
