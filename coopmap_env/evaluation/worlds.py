"""The worlds that can be evaluated, by their names on the command line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.evaluation.serial import settings_from_dict


class Kind(NamedTuple):
    """What makes a world's environments."""

    env: Callable[..., MappingEnv[Any]]
    settings: type[Any]


WORLDS = {"planar": Kind(PlanarEnv, PlanarSettings), "field": Kind(FieldEnv, FieldSettings)}


def kind_of(world: str) -> Kind:
    """What makes the environments of a world.

    Raises
    ------
    ValueError
        With the choices, if the name is unknown.
    """
    if world not in WORLDS:
        raise ValueError(f"world must be one of {', '.join(WORLDS)}, got {world!r}")
    return WORLDS[world]


def make_env(
    world: str, arguments: dict[str, Any], settings: dict[str, Any] | None
) -> MappingEnv[Any]:
    """Make an environment from JSON values.

    Parameters
    ----------
    world : str
        "planar" or "field".
    arguments : dict
        Of its constructor, without the settings.
    settings : dict, optional
        As `settings_to_dict` writes them.
    """
    kind = kind_of(world)
    made = None if settings is None else settings_from_dict(settings, kind.settings)
    return kind.env(**arguments, settings=made)
