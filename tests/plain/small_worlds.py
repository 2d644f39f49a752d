"""Planar worlds in which an episode takes a few milliseconds."""

from coopmap_env import planar_v1
from coopmap_env.sensing import PlanarCamera
from coopmap_env.simulation.scenes.planar import Obstacles

SETTINGS = planar_v1.PlanarSettings(
    camera=PlanarCamera(depth_of_field=6.0, n_beams=16),
    reach=4.0,
    initial_free_radius=1.0,
    max_start_distance=6.0,
    crop_cells=8,
)


def small_world(**arguments):
    scene = Obstacles(shape=(24, 24), side_min=2.0, side_max=6.0)
    return planar_v1.parallel_env(
        **{"scene": scene, "settings": SETTINGS, "max_scans": 4, **arguments}
    )


def masked_world(**arguments):
    """At a start, the 5 known cells give far fewer poses than there are candidates."""
    return small_world(action_mode="candidates", n_candidates=300, **arguments)
