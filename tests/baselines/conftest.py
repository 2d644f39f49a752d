import pytest

from coopmap_env.simulation.scenes.planar import Obstacles, Rooms


@pytest.fixture(
    params=[Obstacles(shape=(56, 56)), Rooms(shape=(64, 64))], ids=lambda scene: scene.name
)
def small_scene(request):
    """A scene small enough to rate every pose of an episode by brute force."""
    return request.param
