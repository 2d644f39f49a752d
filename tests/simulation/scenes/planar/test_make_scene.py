import numpy as np
import pytest

from coopmap_env.mapping.files import write_map_server
from coopmap_env.simulation.scenes import planar as scenes
from coopmap_env.simulation.scenes.planar import (
    Corridors,
    Obstacles,
    PlanarScene,
    Rooms,
    make_planar_scene,
)


def test_all_public_names_exist():
    assert all(hasattr(scenes, name) for name in scenes.__all__)


def test_a_name_makes_the_scene_with_its_default_settings():
    assert make_planar_scene("obstacles") == Obstacles()
    assert make_planar_scene("rooms") == Rooms()
    assert make_planar_scene("corridors") == Corridors()


def test_the_name_house_makes_the_house():
    pytest.importorskip("rtbdata")
    assert make_planar_scene("house").shape == (199, 133)


@pytest.mark.parametrize("name", ["map.yaml", "map.yml", "MAP.YAML"])
def test_a_path_makes_the_recorded_map(tmp_path, name):
    pytest.importorskip("yaml")
    pytest.importorskip("PIL")
    write_map_server(tmp_path / name, np.zeros((8, 9)), 0.1, (0.0, 0.0))
    assert make_planar_scene(tmp_path / name).shape == (8, 9)
    assert make_planar_scene(str(tmp_path / name)).shape == (8, 9)


def test_a_scene_is_returned_as_it_is():
    scene = Obstacles(shape=(30, 30))
    assert make_planar_scene(scene) is scene


@pytest.mark.parametrize("scene", [Obstacles(), Rooms(), Corridors()])
def test_each_scene_is_a_scene_whose_worlds_agree_with_it(scene):
    assert isinstance(scene, PlanarScene)
    world = scene.world(np.random.default_rng(0))
    for field in ("name", "shape", "resolution", "origin"):
        assert getattr(world, field) == getattr(scene, field)


@pytest.mark.parametrize("scene", ["maze", "map.pgm", "", None, 3, Obstacles])
def test_anything_else_is_named_with_the_choices(scene):
    names = "'obstacles', 'rooms', 'corridors', 'house', a path"
    with pytest.raises(ValueError, match=names) as error:
        make_planar_scene(scene)
    assert str(error.value).endswith(f"not {scene!r}")
