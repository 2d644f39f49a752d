import hashlib
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from coopmap_env.simulation.scenes import SPLITS, world_seed
from coopmap_env.simulation.scenes.planar import Rooms
from coopmap_env.simulation.scenes.planar._floor_plan import (
    CellRectangle,
    Door,
    FloorPart,
    FloorPlanSizes,
    choose_doors,
    split_floor,
)

GOLDEN = {"train": "747273c409ffe887", "validation": "eed50a79ba6ca53b", "test": "70f1ee3156539210"}
"""SHA-256 of the first world of each split: changing one changes every published result."""

MEASURES = FloorPlanSizes(wall=1, corridor=4, door=2, room_min=5, room_max=12, corridor_from=20)
TIGHT = Rooms(
    shape=(77, 120),
    room_min=2.0,
    room_max=5.0,
    corridor=1.0,
    door=1.0,
    corridor_from=5.0,
    furniture=2.0,
    aisle=0.2,
)
HALLS = Rooms(shape=(100, 100), room_min=2.4, room_max=5.2, corridor=1.6, halls=0.5, furniture=0.4)
"""Small rooms and halls."""


def first_world(split, scene):
    return scene.world(np.random.default_rng(world_seed(split, 0)))


def n_free_regions(occupied):
    return ndimage.label(~occupied)[1]


@pytest.mark.parametrize(
    "scene", [Rooms(), TIGHT, HALLS, Rooms(shape=(17, 60)), Rooms(shape=(40, 17))]
)
def test_every_free_cell_can_be_reached(scene):
    for seed in range(20):
        occupied = scene.world(np.random.default_rng(seed)).occupied
        assert n_free_regions(occupied) == 1


def test_a_wall_surrounds_the_floor():
    occupied = Rooms(wall=0.4).world(np.random.default_rng(0)).occupied
    inside = np.zeros_like(occupied)
    inside[2:-2, 2:-2] = True
    assert occupied[~inside].all()


def test_a_floor_has_rooms_of_the_requested_sizes():
    for seed in range(20):
        parts = split_floor(np.random.default_rng(seed), (60, 90), MEASURES)
        rooms = [part for part in parts if not part.is_corridor]
        corridors = [part for part in parts if part.is_corridor]
        assert len(rooms) >= 12
        assert corridors
        assert all(min(room.n_x, room.n_y) >= 5 for room in rooms)
        assert all(max(room.n_x, room.n_y) <= 12 for room in rooms)
        assert all(min(corridor.n_x, corridor.n_y) == 4 for corridor in corridors)


def test_a_part_larger_than_a_room_may_stay_a_hall():
    sizes = replace(MEASURES, hall_max=24, halls=0.5)
    n_halls, n_small = 0, 0
    for seed in range(20):
        for part in split_floor(np.random.default_rng(seed), (60, 90), sizes):
            shorter, longer = sorted((part.n_x, part.n_y))
            if not part.is_corridor and longer > 12:
                assert 12 < shorter <= longer <= 24
                n_halls += 1
            n_small += not part.is_corridor and longer <= 12
    assert n_halls >= 20
    assert n_small >= 100


def test_without_halls_nothing_more_is_drawn():
    a, b = (
        split_floor(np.random.default_rng(0), (60, 90), sizes)
        for sizes in (MEASURES, replace(MEASURES, hall_max=24))
    )
    assert a == b


def test_small_rooms_and_halls_stand_on_one_floor():
    n_mixed = 0
    for seed in range(40):
        parts = split_floor(np.random.default_rng(seed), HALLS.shape, HALLS._sizes_in_cells)
        rooms = [part for part in parts if not part.is_corridor]
        areas = np.array([room.n_x * room.n_y * HALLS.resolution**2 for room in rooms])
        n_mixed += np.count_nonzero(areas <= 16.0) >= 3 and areas.max() >= 40.0
    assert n_mixed >= 34


def test_parts_are_disjoint_and_inside_the_outer_wall():
    for seed in range(20):
        n_parts = np.zeros((60, 90), dtype=int)
        for part in split_floor(np.random.default_rng(seed), (60, 90), MEASURES):
            n_parts[part.slices] += 1
        assert n_parts.max() == 1
        assert not n_parts[[0, -1]].any()
        assert not n_parts[:, [0, -1]].any()


def test_two_rooms_get_one_door_in_the_wall_between_them():
    rooms = [FloorPart(1, 1, 6, 6), FloorPart(8, 3, 6, 6)]
    for seed in range(10):
        (door,) = choose_doors(np.random.default_rng(seed), rooms, MEASURES, extra=1.0)
        assert (door.x, door.n_x, door.n_y) == (7, 1, 2)
        assert 3 <= door.y <= 5  # both rooms lie at y = 3, 4, 5, 6
        assert (door.first, door.second) == (0, 1)


def test_a_wall_narrower_than_a_door_gets_none():
    rooms = [FloorPart(1, 1, 6, 6), FloorPart(8, 6, 6, 6)]  # they face each other at y = 6 only
    assert choose_doors(np.random.default_rng(0), rooms, MEASURES, extra=1.0) == []


def test_corridors_open_into_each_other_over_their_full_width():
    corridors = [
        FloorPart(1, 1, 30, 4, is_corridor=True),
        FloorPart(10, 6, 4, 20, is_corridor=True),
    ]
    doors = choose_doors(np.random.default_rng(0), corridors, MEASURES, extra=0.0)
    assert doors == [Door(10, 5, 4, 1, 0, 1)]


def test_without_extra_doors_the_openings_are_a_spanning_tree():
    for seed in range(20):
        rng = np.random.default_rng(seed)
        parts = split_floor(rng, (60, 90), MEASURES)
        doors = choose_doors(rng, parts, MEASURES, extra=0.0)
        assert len(doors) == len(parts) - 1
        every = choose_doors(rng, parts, MEASURES, extra=1.0)
        assert len(every) > len(doors)


def test_growing_cells_stops_at_index_0():
    assert CellRectangle(1, 5, 2, 3).expanded(2) == CellRectangle(0, 3, 5, 7)


def test_furniture_takes_up_floor_and_more_tries_take_up_more():
    fractions = [
        np.mean([s.world(np.random.default_rng(i)).occupied.mean() for i in range(5)])
        for s in (Rooms(furniture=0.0), Rooms(furniture=0.1), Rooms(furniture=0.5))
    ]
    assert fractions[0] < fractions[1] < fractions[2] < 0.3


def test_a_world_carries_the_fields_of_its_scene():
    scene = Rooms(shape=(60, 40), resolution=0.25, origin=(-1.0, 2.0))
    world = first_world("train", scene)
    assert world.shape == scene.shape == (60, 40)
    assert (world.resolution, world.origin, world.name) == (0.25, (-1.0, 2.0), "rooms")


def test_the_same_generator_state_makes_the_same_world():
    a, b = (Rooms().world(np.random.default_rng(5)).occupied for _ in range(2))
    other = Rooms().world(np.random.default_rng(6)).occupied
    np.testing.assert_array_equal(a, b)
    assert (a != other).any()


@pytest.mark.parametrize("split", SPLITS)
def test_the_first_world_of_each_split_is_frozen(split):
    packed = np.packbits(first_world(split, Rooms()).occupied)
    assert hashlib.sha256(packed.tobytes()).hexdigest()[:16] == GOLDEN[split]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"shape": (4, 200)}, r"Rooms.shape must be .*>= 8.*, got \(4, 200\)"),
        ({"shape": (16, 200)}, r"a room of 3.0 m .*\(16, 200\)"),
        ({"resolution": 0.0}, "Rooms.resolution must be a finite number > 0, got 0.0"),
        ({"wall": 0.0}, "Rooms.wall must be a finite number > 0, got 0.0"),
        ({"aisle": float("nan")}, "Rooms.aisle must be a finite number > 0, got nan"),
        ({"corridor": float("inf")}, "Rooms.corridor must be a finite number > 0, got inf"),
        ({"door": 2.4}, "door must fit .* not 2.4 m"),
        ({"room_max": 6.0}, "room_max must hold two rooms .* not 6.0 m"),
        ({"extra_doors": -0.1}, "Rooms.extra_doors must be .*>= 0 and <= 1, got -0.1"),
        ({"furniture": -1.0}, "Rooms.furniture must be a finite number >= 0, got -1.0"),
        ({"halls": 1.5}, "Rooms.halls must be .*>= 0 and <= 1, got 1.5"),
        ({"halls": 0.5, "hall_max": 8.0}, r"hall_max must exceed room_max \(8.0 m\) .* not 8.0 m"),
        ({"furniture_sides": (2.0, 1.0)}, r"\(2.0, 1.0\)"),
    ],
)
def test_a_wrong_setting_is_named_with_its_value(change, message):
    with pytest.raises(ValueError, match=message):
        replace(Rooms(), **change)
