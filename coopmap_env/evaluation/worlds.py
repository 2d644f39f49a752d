"""The worlds that can be evaluated, by their names on the command line."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from coopmap_env.core.serial import settings_from_dict
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings
from coopmap_env.simulation.scenes.field import Clutter, Rubble, Worksite
from coopmap_env.simulation.scenes.planar import Obstacles, Rooms


class Kind(NamedTuple):
    """What makes a world's environments."""

    constructor: Callable[..., MappingEnv[Any]]
    settings: type[Any]
    scenes: dict[str, type[Any]]
    """Those that can be given as JSON objects, by name."""

    def env(self, **arguments: Any) -> MappingEnv[Any]:
        """Make an environment.

        Parameters
        ----------
        **arguments
            Of its constructor. A scene may be a JSON object too, such as
            ``{"name": "obstacles", "shape": [150, 150]}``: the fields of the scene of that name.

        Raises
        ------
        ValueError
            If an argument is not accepted, such as a scene's name or field.
        """
        scene = arguments.get("scene")
        if isinstance(scene, Mapping):
            arguments["scene"] = self._scene(dict(scene))
        return self.constructor(**arguments)

    def _scene(self, fields: dict[str, Any]) -> Any:
        name = fields.pop("name", None)
        if name not in self.scenes:
            raise ValueError(
                f"the name of a scene with fields must be one of {', '.join(self.scenes)}, "
                f"got {name!r}"
            )
        try:
            return settings_from_dict(fields, self.scenes[name])
        except ValueError as error:
            raise ValueError(f"scene {name!r}: {error}") from error


WORLDS = {
    "planar": Kind(PlanarEnv, PlanarSettings, {"obstacles": Obstacles, "rooms": Rooms}),
    "field": Kind(
        FieldEnv, FieldSettings, {"worksite": Worksite, "clutter": Clutter, "rubble": Rubble}
    ),
}


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
        Of its constructor, without the settings; see `Kind.env`.
    settings : dict, optional
        As `settings_to_dict` writes them.
    """
    kind = kind_of(world)
    made = None if settings is None else settings_from_dict(settings, kind.settings)
    return kind.env(**arguments, settings=made)
