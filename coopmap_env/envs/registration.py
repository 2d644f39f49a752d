"""Names under which Gymnasium and PettingZoo find the environments."""

import gymnasium
import pettingzoo

WORLDS = {"coopmap/Planar-v0": "Planar", "coopmap/Field-v0": "Field"}


def register() -> None:
    """Enter the environments into both registries; done once, on import of `coopmap_env`."""
    for name, world in WORLDS.items():
        module = f"coopmap_env.envs.{world.lower()}"
        pettingzoo.register("parallel", name, f"{module}:{world}Env")
        gymnasium.register(name, f"{module}:{world}TeamEnv")
