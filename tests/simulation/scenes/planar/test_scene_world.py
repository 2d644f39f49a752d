import pickle

import numpy as np
import pytest

from coopmap_env.simulation.scenes.planar import PlanarScene, PlanarWorld


def free(*shape):
    return np.zeros(shape, dtype=bool)


def test_a_world_states_its_shape_in_cells_along_x_then_y():
    assert PlanarWorld(free(8, 12), 0.5, (0.0, 0.0), "field").shape == (8, 12)


def test_a_world_keeps_a_read_only_c_contiguous_copy():
    drawn = free(12, 8).T
    world = PlanarWorld(drawn, 0.5, (0.0, 0.0), "field")
    drawn[0, 0] = True
    assert not world.occupied.any()
    assert world.occupied.flags.c_contiguous
    with pytest.raises(ValueError, match="read-only"):
        world.occupied[0, 0] = True


def test_a_world_survives_pickling():
    occupied = free(8, 9)
    occupied[2, 3] = True
    copy = pickle.loads(pickle.dumps(PlanarWorld(occupied, 0.5, (1.0, 2.0), "field")))
    np.testing.assert_array_equal(copy.occupied, occupied)
    assert (copy.resolution, copy.origin, copy.name) == (0.5, (1.0, 2.0), "field")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"occupied": free(8, 8, 8)}, r"2 axes.*\(8, 8, 8\)"),
        ({"occupied": np.zeros((8, 8))}, "float64"),
        ({"occupied": free(7, 8)}, r"8 x 8 cells, not \(7, 8\)"),
        ({"occupied": ~free(8, 8)}, "no free cell: all 64"),
        ({"resolution": 0.0}, "above 0 m, not 0.0"),
        ({"resolution": float("nan")}, "nan"),
        ({"resolution": float("inf")}, "inf"),
        ({"origin": (0.0,)}, r"two finite numbers .*\(0.0,\)"),
        ({"origin": (0.0, float("nan"))}, "nan"),
    ],
)
def test_a_world_names_the_value_that_is_wrong(change, message):
    fields = {"occupied": free(8, 8), "resolution": 1.0, "origin": (0.0, 0.0), "name": "field"}
    with pytest.raises(ValueError, match=message):
        PlanarWorld(**(fields | change))


def test_whatever_has_the_attributes_of_a_scene_is_one():
    class Field:
        name, shape, resolution, origin = "field", (8, 8), 1.0, (0.0, 0.0)

        def world(self, rng):
            return PlanarWorld(free(8, 8), 1.0, (0.0, 0.0), "field")

    assert isinstance(Field(), PlanarScene)
    assert not isinstance(object(), PlanarScene)
