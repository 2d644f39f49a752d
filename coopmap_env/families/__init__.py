"""Benchmark families: tasks with frozen worlds, on which policies are compared.

::

    from coopmap_env import families

    env = families.make("crowded", split="test", action_mode="candidates")
    observations, infos = env.reset(seed=0)  # world 0 of the test split

A family has its own scene, team, budget and settings. What a policy chooses is free: how it acts
(``action_mode``, ``n_candidates``) and what it learns from (``reward``, ``team_reward``). Train on
the worlds of "train", choose settings on "validation", report "test" once. Every family is also
registered under an id, such as ``coopmap/Planar-crowded-v1``, in Gymnasium and PettingZoo.

=================  ===========================================================================
`FAMILIES`         all of them by name
`get`              one of them: `Family`
`make`             its parallel environment; `make_team`, `make_vector`: one controller, many worlds
`check_world`      whether a world is the frozen one
=================  ===========================================================================
"""

from __future__ import annotations

from typing import Any

from coopmap_env.core.choices import unknown
from coopmap_env.envs import MappingEnv, TeamEnv
from coopmap_env.families.family import FREE_ARGUMENTS, Family
from coopmap_env.families.field import FIELD_FAMILIES
from coopmap_env.families.planar import PLANAR_FAMILIES
from coopmap_env.families.worlds import N_WORLDS, WorldMismatchError, check_world, world_hash
from coopmap_env.vector import MappingVectorEnv

__all__ = [
    "FAMILIES",
    "FREE_ARGUMENTS",
    "N_WORLDS",
    "Family",
    "WorldMismatchError",
    "check_world",
    "get",
    "make",
    "make_team",
    "make_vector",
    "world_hash",
]

FAMILIES: dict[str, Family] = {
    family.name: family for family in (*PLANAR_FAMILIES, *FIELD_FAMILIES)
}
"""The families by name."""


def get(name: str) -> Family:
    """The family of a name.

    Raises
    ------
    ValueError
        With the choices, if the name is unknown.
    """
    if not isinstance(name, str) or name not in FAMILIES:
        raise ValueError(unknown("family", name, FAMILIES))
    return FAMILIES[name]


def make(family: str, split: str = "train", **options: Any) -> MappingEnv[Any]:
    """Make the parallel environment of a family; see `Family.make`."""
    return get(family).make(split, **options)


def make_team(family: str, split: str = "train", **options: Any) -> TeamEnv:
    """Make the environment of one controller for the whole team; see `Family.make`."""
    return get(family).make_team(split, **options)


def make_vector(
    family: str, n_envs: int, split: str = "train", **options: Any
) -> MappingVectorEnv[Any]:
    """Make many worlds of a family; see `Family.make_vector`."""
    return get(family).make_vector(n_envs, split, **options)
