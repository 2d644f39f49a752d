import json

import pytest

from coopmap_env.evaluation import compare, make_env
from coopmap_env.simulation.scenes.field import Rubble
from coopmap_env.simulation.scenes.planar import Obstacles

BLOCKS = {"name": "obstacles", "shape": [60, 50], "occupied_fraction": 0.24}


def test_a_scene_may_be_a_json_object_of_its_fields():
    env = make_env("planar", {"scene": json.loads(json.dumps(BLOCKS))}, None)
    assert env.scene == Obstacles(shape=(60, 50), occupied_fraction=0.24)
    env.reset(seed=0)
    assert env.truth.occupied.mean() == pytest.approx(0.24)


def test_a_field_scene_may_be_a_json_object_too():
    pytest.importorskip("pybullet")
    env = make_env("field", {"scene": {"name": "rubble", "blocks": [15, 20]}}, None)
    assert env.scene == Rubble(blocks=(15, 20))
    env.close()


def test_a_comparison_takes_a_scene_of_json(tmp_path):
    found = compare(["random"], [0], {"scene": BLOCKS, "max_scans": 1}, tmp_path, progress=False)
    assert len(found["random"].episodes) == 1


@pytest.mark.parametrize(
    ("scene", "message"),
    [
        ({"shape": [60, 50]}, "must be one of obstacles, rooms, corridors, got None"),
        ({"name": "moon"}, "must be one of obstacles, rooms, corridors, got 'moon'"),
        ({"name": "obstacles", "craters": 3}, r"scene 'obstacles': unknown .*\['craters'\]; known"),
        (
            {"name": "obstacles", "occupied_fraction": 2},
            "'obstacles': Obstacles.occupied_fraction must be",
        ),
    ],
)
def test_an_error_names_the_scene_and_the_choices(scene, message):
    with pytest.raises(ValueError, match=message):
        make_env("planar", {"scene": scene}, None)
