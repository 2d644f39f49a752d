"""Ids under which Gymnasium and PettingZoo find the environments."""

from typing import Any

import gymnasium
import pettingzoo

from coopmap_env.core.choices import unknown

SEARCH_ARGUMENTS = {"initialization": "search", "motion_correction": "fiducials"}
"""The full method of the paper: robots find the target first, fiducials correct camera poses."""
ENVS: dict[str, tuple[str, dict[str, Any]]] = {
    "coopmap/Planar-v1": ("Planar", {}),
    "coopmap/Field-v1": ("Field", {}),
    "coopmap/FieldSearch-v1": ("Field", SEARCH_ARGUMENTS),
}
"""Class prefix and arguments of each id."""

FAMILIES = {
    "crowded": "Planar",
    "long": "Planar",
    "motion-budget": "Planar",
    "narrow": "Planar",
    "occluded": "Field",
    "time": "Field",
}
"""Kind of world of each benchmark family; see `coopmap_env.families`, which this does not load."""


def family_env_name(family: str) -> str:
    """Kind of the environment of a family: "planar" or "field".

    Raises
    ------
    ValueError
        If there is no such family; with the choices.
    """
    if family not in FAMILIES:
        raise ValueError(unknown("family", family, FAMILIES))
    return FAMILIES[family].lower()


def register_envs() -> None:
    """Register the environments in both registries; done once, on import of `coopmap_env`."""
    for name, (world, arguments) in ENVS.items():
        module = f"coopmap_env.envs.{world.lower()}"
        pettingzoo.register("parallel", name, f"{module}:{world}Env", kwargs=arguments)
        gymnasium.register(name, f"{module}:{world}TeamEnv", kwargs=arguments)
    for family, world in FAMILIES.items():
        name, chosen = f"coopmap/{world}-{family}-v1", {"family": family}
        pettingzoo.register("parallel", name, "coopmap_env.families:make", kwargs=chosen)
        gymnasium.register(name, "coopmap_env.families:make_team", kwargs=chosen)
