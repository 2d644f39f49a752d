"""Names under which Gymnasium and PettingZoo find the environments."""

import gymnasium
import pettingzoo

ID = "coopmap/Planar-v0"


def register() -> None:
    """Enter the environments into both registries; done once, on import of `coopmap_env`."""
    pettingzoo.register("parallel", ID, "coopmap_env.envs.planar:PlanarEnv")
    gymnasium.register(ID, "coopmap_env.envs.planar:PlanarTeamEnv")
