"""Options of the commands that make an environment."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, ClassVar, Literal

from coopmap_env.envs import MappingEnv
from coopmap_env.envs.arguments import TaskArguments
from coopmap_env.envs.field.arguments import Initialization, MotionCorrection
from coopmap_env.simulation import Physics


@dataclass(frozen=True, kw_only=True)
class EnvironmentOptions(TaskArguments):
    """Which environment, and its arguments.

    Those of all environments are inherited. Of those declared here, an empty text or None stands
    for the environment's default: what is given beside a family is noticed, also if it is the
    default.
    """

    DEFAULT_ENV: ClassVar[Literal["planar", "field"]] = "planar"
    """Kind of the environment without ``--env`` and ``--family``."""

    family: str = ""
    """Benchmark family, such as crowded, instead of a scene, a team and a budget of your own; see
    coopmap_env.families."""
    env: Literal["", "planar", "field"] = ""
    """2-D (planar; default) or 3-D (field); "field" needs the extra of that name."""
    n_robots: int | None = None  # type: ignore[assignment]  # an option may be left out
    """Robots in the team, 2 by default."""
    max_scans: int | None = None  # type: ignore[assignment]
    """Scans of each robot until truncation, 16 by default."""
    scene: str = ""
    """planar: obstacles (default), rooms, corridors, house, or a ROS map_server YAML file; field:
    worksite (default), clutter, rubble, occluded, or a YAML file of meshes."""
    mount: str = ""
    """field: mast (default), husky_panda or tiago; or one for each robot, separated by commas."""
    physics: Literal["", Physics] = ""
    """field: kinematic (default) or stepped; see FieldSettings.physics."""
    initialization: Literal["", Initialization] = ""
    """field: located (default), or search: robots localize themselves on the target first."""
    motion_correction: Literal["", MotionCorrection] = ""
    """field: source of camera poses: encoders, kinematic (default), fiducials or exact."""

    def __post_init__(self) -> None:
        """Accept any value: the environment checks it, outside of the parser of the command line.

        So a wrong value gives one line of `coopmap_env.cli.main`, whatever the argument.
        """

    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment, without the split and the settings.

        Raises
        ------
        ValueError
            If an option of the field environment is given for the planar one, or one that belongs
            to the family is given beside it.
        """
        if self.family:
            return self._family_kwargs()
        for name in ("mount", "physics", "initialization", "motion_correction"):
            if self.env_name != "field" and getattr(self, name):
                option = name.replace("_", "-")
                raise ValueError(f"--{option} belongs to --env field, not to --env {self.env_name}")
        arguments = {}
        for argument in fields(TaskArguments):
            value = getattr(self, argument.name)
            arguments[argument.name] = argument.default if value is None else value
        if self.mount:
            arguments["mount"] = parse_mounts(self.mount)
        for name in ("scene", "initialization", "motion_correction"):
            if getattr(self, name):
                arguments[name] = getattr(self, name)
        return arguments

    @property
    def env_name(self) -> str:
        """Kind of the environment: "planar" or "field"."""
        return self._family().env_name if self.family else self.env or self.DEFAULT_ENV

    def _family(self) -> Any:
        from coopmap_env import families

        return families.get(self.family)

    def _family_kwargs(self) -> dict[str, Any]:
        """Arguments of the family, and those that it leaves free."""
        from coopmap_env.families import FREE_ARGUMENTS

        arguments = self._family().env_kwargs
        for option in fields(EnvironmentOptions):
            value = getattr(self, option.name)
            if option.name in FREE_ARGUMENTS:
                arguments[option.name] = value
            elif option.name != "family" and value not in ("", None):
                raise ValueError(
                    f"--{option.name.replace('_', '-')} belongs to --family {self.family}, which "
                    "has its own: leave it out"
                )
        return arguments

    def settings(self) -> Any:
        """Settings of the environment, or None for the defaults."""
        from coopmap_env.evaluation import get_env_spec

        if self.family:
            return self._family().settings
        if not self.physics:
            return None
        return get_env_spec(self.env_name).settings_class(physics=self.physics)

    def make_env(self, split: str) -> MappingEnv[Any]:
        """Make the environment of a split."""
        from coopmap_env.evaluation import get_env_spec

        return get_env_spec(self.env_name).make(
            **self.env_kwargs(), split=split, settings=self.settings()
        )


def parse_mounts(text: str) -> str | list[str]:
    """One mount for all robots, or a list with one for each if there is a comma."""
    return text.split(",") if "," in text else text
