import numpy as np
import pytest

from coopmap_env.mapping.files import write_map_server


@pytest.fixture(scope="session")
def map_file(tmp_path_factory):
    """A recorded map of 30 x 24 cells of half a metre, walls and a hole in them."""
    pytest.importorskip("yaml")
    pytest.importorskip("PIL")
    path = tmp_path_factory.mktemp("maps") / "hall.yaml"
    occupied = np.zeros((30, 24))
    occupied[[0, -1]] = occupied[:, [0, -1]] = 1
    occupied[12, :10] = occupied[12, 14:] = 1
    write_map_server(path, occupied, 0.5, (-3.0, 2.0))
    return path


@pytest.fixture(params=["obstacles", "rooms", "corridors", "house", "recorded"])
def scene(request):
    """Every kind of scene that the environments know by name or file."""
    if request.param == "recorded":
        return str(request.getfixturevalue("map_file"))
    if request.param == "house":
        pytest.importorskip("rtbdata")
    return request.param
