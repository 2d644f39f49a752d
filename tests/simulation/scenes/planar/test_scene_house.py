import sys
from importlib import resources
from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.planar import largest_free_region, load_house

GARAGE = (500, 150)
"""In the middle of the garage, in cells of the drawing."""


def test_the_house_is_26_by_17_metres_in_cells_of_13_and_a_half_centimetres():
    pytest.importorskip("rtbdata")
    scene = load_house()
    assert scene.name == "house"
    assert scene.shape == (199, 133)
    assert scene.resolution == pytest.approx(0.135)
    assert scene.origin == (0.0, 0.0)


def test_the_drawing_has_596_by_397_cells():
    pytest.importorskip("rtbdata")
    scene = load_house(pool=1)
    assert scene.shape == (596, 397)
    assert scene.resolution == 0.045


def test_x_and_y_run_as_on_the_drawing():
    pytest.importorskip("rtbdata")
    occupied = load_house(pool=1).truth.occupied
    x, y = GARAGE
    # From the garage, walls on the right and below are near, and the driveway lies above.
    assert occupied[x : x + 90, y].any()
    assert occupied[x, :y].any()
    assert not occupied[x, 250:].any()


def test_all_named_places_lie_in_one_free_region():
    rtbdata = pytest.importorskip("rtbdata")
    places = loadmat(resources.files(rtbdata) / "data" / "house.mat")["places"][0, 0]
    region = largest_free_region(load_house().truth.occupied)
    for name in places.dtype.names:
        x, y = places[name].ravel().astype(int) // 3
        assert region[x, y], name


def test_a_cell_is_occupied_just_where_the_drawing_has_a_line_in_it():
    pytest.importorskip("rtbdata")
    fine, coarse = load_house(pool=1).truth.occupied, load_house(pool=3).truth.occupied
    assert coarse[tuple(np.argwhere(fine).T // 3)].all()
    for x, y in np.argwhere(coarse):
        assert fine[3 * x : 3 * x + 3, 3 * y : 3 * y + 3].any()


def test_without_its_data_the_house_names_the_pip_command(monkeypatch):
    monkeypatch.setitem(sys.modules, "rtbdata", None)
    with pytest.raises(ImportError, match=r"pip install 'coopmap\[data\]'"):
        load_house()


@pytest.mark.parametrize("content", [None, {"plan": np.eye(9)}, {"floorplan": np.full((9, 9), 7)}])
def test_a_file_without_floor_plan_is_named(tmp_path, monkeypatch, content):
    (tmp_path / "data").mkdir()
    (tmp_path / "__init__.py").touch()
    if content is not None:
        savemat(tmp_path / "data" / "house.mat", content)
    spec = spec_from_file_location("rtbdata", tmp_path / "__init__.py")
    monkeypatch.setitem(sys.modules, "rtbdata", module_from_spec(spec))
    with pytest.raises(SceneError, match=r"house\.mat: floorplan"):
        load_house()
