"""Write what robots have mapped in the form of ROS map_server (see `map_server`).

The writer is the map's own (`coopmap_env.mapping.files`); here it stands beside the reader of
scenes, which takes back what it wrote as a world.
"""

from coopmap_env.mapping.files.map_server import FREE_THRESH, OCCUPIED_THRESH
from coopmap_env.mapping.files.map_server import write_map_server as save_map_server

__all__ = ["FREE_THRESH", "OCCUPIED_THRESH", "save_map_server"]
