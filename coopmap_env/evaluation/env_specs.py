"""Environments by name, made from JSON values: for the command line, jobs and training."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

from coopmap_env import field_v1, planar_v1
from coopmap_env.core.settings import settings_from_dict
from coopmap_env.envs import MappingEnv, TeamEnv
from coopmap_env.envs.field import FieldEnv, FieldSettings, FieldTeamEnv
from coopmap_env.envs.planar import PlanarEnv, PlanarSettings, PlanarTeamEnv
from coopmap_env.robots import mount_from_json
from coopmap_env.simulation.scenes.field import FIELD_SCENES
from coopmap_env.simulation.scenes.planar import PLANAR_SCENES
from coopmap_env.vector import MappingVectorEnv


class EnvSpec(NamedTuple):
    """What makes the environments of a name."""

    constructor: Callable[..., MappingEnv[Any]]
    team_constructor: Callable[..., TeamEnv]
    vector_constructor: Callable[..., MappingVectorEnv[Any]]
    settings_class: type[Any]
    scenes: Mapping[str, Callable[[], Any]]
    """Makers of the scenes with a name."""

    @property
    def scene_classes(self) -> dict[str, type[Any]]:
        """Scenes that can be given as JSON objects, by name."""
        return {name: make for name, make in self.scenes.items() if isinstance(make, type)}

    def make(self, **arguments: Any) -> MappingEnv[Any]:
        """Make an environment.

        Parameters
        ----------
        **arguments
            Of its constructor. A scene may also be a JSON object with the fields of the scene of
            that name, such as ``{"name": "obstacles", "shape": [150, 150]}``, a mount one with
            `MountFields`: ``{"urdf": "arm.urdf", "joints": ["pan"], "camera_link": "eye"}``.

        Raises
        ------
        ValueError
            If an argument is not accepted, such as a scene's name or field.
        """
        return self.constructor(**self._with_objects(arguments))

    def make_team(self, **arguments: Any) -> TeamEnv:
        """Make an environment of one controller for the whole team; see `make`."""
        return self.team_constructor(**self._with_objects(arguments))

    def make_vector(self, n_envs: int, **arguments: Any) -> MappingVectorEnv[Any]:
        """Make a vector environment of `n_envs` worlds; see `make`."""
        return self.vector_constructor(n_envs, **self._with_objects(arguments))

    def _with_objects(self, arguments: dict[str, Any]) -> dict[str, Any]:
        """The arguments with the scene and the mounts that are given as JSON objects."""
        made = dict(arguments)
        if isinstance(scene := arguments.get("scene"), Mapping):
            made["scene"] = self._make_scene(dict(scene))
        mount = arguments.get("mount")
        if isinstance(mount, Mapping):
            made["mount"] = mount_from_json(mount)
        elif isinstance(mount, list | tuple):
            made["mount"] = [
                mount_from_json(one) if isinstance(one, Mapping) else one for one in mount
            ]
        return made

    def _make_scene(self, fields: dict[str, Any]) -> Any:
        name = fields.pop("name", None)
        if name not in self.scene_classes:
            raise ValueError(
                f"the name of a scene with fields must be one of {', '.join(self.scene_classes)}, "
                f"got {name!r}"
            )
        try:
            return settings_from_dict(fields, self.scene_classes[name])
        except ValueError as error:
            raise ValueError(f"scene {name!r}: {error}") from error


def _planar_vector_env(
    n_envs: int, num_workers: int = 0, **arguments: Any
) -> MappingVectorEnv[Any]:
    """Planar worlds, with threads in place of worker processes."""
    return planar_v1.vector_env(n_envs, num_threads=max(num_workers, 1), **arguments)


ENV_SPECS = {
    "planar": EnvSpec(PlanarEnv, PlanarTeamEnv, _planar_vector_env, PlanarSettings, PLANAR_SCENES),
    "field": EnvSpec(FieldEnv, FieldTeamEnv, field_v1.vector_env, FieldSettings, FIELD_SCENES),
}


def get_env_spec(env_name: str) -> EnvSpec:
    """What makes the environments of a name.

    Raises
    ------
    ValueError
        With the choices, if the name is unknown.
    """
    if env_name not in ENV_SPECS:
        raise ValueError(f"env_name must be one of {', '.join(ENV_SPECS)}, got {env_name!r}")
    return ENV_SPECS[env_name]


def make_env(
    env_name: str, arguments: dict[str, Any], settings: dict[str, Any] | None
) -> MappingEnv[Any]:
    """Make an environment from JSON values.

    Parameters
    ----------
    env_name : {"planar", "field"}
    arguments : dict
        Of its constructor, without the settings; see `EnvSpec.make`.
    settings : dict, optional
        As `settings_to_dict` writes them.
    """
    spec = get_env_spec(env_name)
    return spec.make(**arguments, settings=_typed(settings, spec))


def make_team_env(
    env_name: str, arguments: dict[str, Any], settings: dict[str, Any] | None
) -> TeamEnv:
    """Make an environment of one controller for the whole team from JSON values; see `make_env`."""
    spec = get_env_spec(env_name)
    return spec.make_team(**arguments, settings=_typed(settings, spec))


def make_vector_env(
    env_name: str,
    n_envs: int,
    arguments: dict[str, Any],
    settings: dict[str, Any] | None,
    **options: Any,
) -> MappingVectorEnv[Any]:
    """Make a vector environment from JSON values.

    Parameters
    ----------
    env_name, arguments, settings
        As in `make_env`.
    n_envs : int
        Number of worlds.
    **options
        Of the vector environment, such as ``rows`` or ``num_workers``; planar worlds are stepped
        by as many threads.
    """
    spec = get_env_spec(env_name)
    return spec.make_vector(n_envs, **arguments, **options, settings=_typed(settings, spec))


def _typed(settings: dict[str, Any] | None, spec: EnvSpec) -> Any:
    return None if settings is None else settings_from_dict(settings, spec.settings_class)
