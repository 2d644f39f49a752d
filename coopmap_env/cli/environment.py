"""Options of the commands that make an environment."""

from __future__ import annotations

from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal

from coopmap_env.core.choices import unknown
from coopmap_env.envs.arguments import TaskArguments
from coopmap_env.envs.registration import family_env_name

if TYPE_CHECKING:  # what makes an environment takes longer to load than to refuse an option
    from coopmap_env.envs import MappingEnv
    from coopmap_env.families import Family

SCENES = {
    "planar": ("obstacles", "rooms", "corridors", "house"),
    "field": ("worksite", "clutter", "rubble", "occluded"),
}
"""Names of `PLANAR_SCENES` and `FIELD_SCENES`."""
MOUNTS = ("mast", "husky_panda", "tiago")
"""Names that `make_mount` knows."""
URDF_OPTIONS = ("joints", "camera_link", "home")
"""Options that belong to a URDF as mount."""


@dataclass(frozen=True, kw_only=True)
class EnvironmentOptions(TaskArguments):
    """Which environment, and its arguments.

    Those of all environments are inherited. Of those declared here, None stands for the
    environment's default: what is given beside a family is noticed, also if it is the default.
    """

    DEFAULT_ENV: ClassVar[Literal["planar", "field"]] = "planar"
    """Kind of the environment without ``--env`` and ``--family``."""

    family: str | None = None
    """Benchmark family, such as crowded. It stands for a scene, a team and a budget; see
    coopmap_env.families."""
    env: Literal["planar", "field"] | None = None
    """2-D (planar, the default) or 3-D (field, which needs the extra of that name)."""
    n_robots: int | None = None  # type: ignore[assignment]  # an option may be left out
    """Robots in the team, 2 by default."""
    max_scans: int | None = None  # type: ignore[assignment]
    """Scans of each robot until truncation, 16 by default."""
    scene: str | None = None
    """Name of a scene, or a YAML file. planar: obstacles (default), rooms, corridors, house, or a
    ROS map_server file; field: worksite (default), clutter, rubble, occluded, or a file of meshes,
    URDFs and boxes."""
    mount: str | None = None
    """field: mast (default), husky_panda, tiago, or a URDF. Or names for each robot, separated by
    commas. A URDF needs --joints and --camera-link."""
    joints: tuple[str, ...] = ()
    """Joints of the URDF that move the camera. All others are fixed."""
    camera_link: str | None = None
    """Link of the URDF that the camera is fixed to. Its x is the optical axis, and its y points
    left."""
    optical_frame: bool = False
    """The camera link is an optical frame. Its z is the optical axis, and its x points right."""
    home: tuple[float, ...] = ()
    """Values of the joints of the URDF at the start. By default 0, or the nearest limit."""
    root_height: float = 0.0
    """Height of the root link of the URDF above ground, metres."""
    physics: Literal["kinematic", "stepped"] | None = None
    """field: kinematic (default) or stepped physics. See FieldSettings.physics."""
    initialization: Literal["located", "search"] | None = None
    """field: located (default), or search for the target first. Robots then localize themselves on
    it."""
    motion_correction: Literal["encoders", "kinematic", "fiducials", "exact"] | None = None
    """field: source of the camera poses, kinematic by default."""

    def __post_init__(self) -> None:
        """Accept any value: the environment checks it, outside of the parser of the command line.

        So a wrong value gives one line of `coopmap_env.cli.main`, whatever the argument.
        """

    def env_kwargs(self) -> dict[str, Any]:
        """Arguments of the environment, without the split and the settings.

        Raises
        ------
        ValueError
            If a value is not accepted, an option of the field environment is given for the planar
            one, or one that belongs to the family is given beside it.
        """
        if self.family is not None:
            return self._family_kwargs()
        for name in ("mount", "physics", "initialization", "motion_correction"):
            if self.env_name != "field" and getattr(self, name):
                option = name.replace("_", "-")
                raise ValueError(f"--{option} belongs to --env field, not to --env {self.env_name}")
        arguments: dict[str, Any] = {}
        for argument in fields(TaskArguments):
            value = getattr(self, argument.name)
            arguments[argument.name] = argument.default if value is None else value
        try:
            TaskArguments(**arguments)
        except ValueError as error:
            raise ValueError(str(error).removeprefix("TaskArguments.")) from error
        if self.scene is not None:
            check_scene(self.scene, self.env_name)
        if (mount := self._mount()) is not None:
            arguments["mount"] = mount
        for name in ("scene", "initialization", "motion_correction"):
            if getattr(self, name):
                arguments[name] = getattr(self, name)
        return arguments

    @property
    def env_name(self) -> str:
        """Kind of the environment: "planar" or "field"."""
        if self.family is None:
            return self.env or self.DEFAULT_ENV
        return family_env_name(self.family)

    def _mount(self) -> str | list[str] | dict[str, Any] | None:
        """The argument `mount`: names, or `MountFields` of a URDF."""
        given = [name for name in URDF_OPTIONS if getattr(self, name) not in ((), None)]
        if self.mount is None or not is_urdf(self.mount):
            if given:
                raise ValueError(f"--{given[0].replace('_', '-')} belongs to --mount FILE.urdf")
            return None if self.mount is None else parse_mounts(self.mount)
        if not Path(self.mount).is_file():
            raise ValueError(f"--mount {self.mount}: there is no such file")
        if not self.joints or self.camera_link is None:
            raise ValueError(
                f"--mount {self.mount} needs --joints, those that move the camera, and "
                "--camera-link, the link that it is fixed to"
            )
        return {
            "urdf": self.mount,
            "joints": list(self.joints),
            "camera_link": self.camera_link,
            "home": list(self.home) or None,
            "root_height": self.root_height,
            "optical_frame": self.optical_frame,
        }

    def extras(self) -> list[str]:
        """Extras that the environment needs."""
        needed = ["field"] if self.env_name == "field" else []
        if "tiago" in (self.mount or ""):
            needed.append("mounts")
        if self.scene == "house":
            needed.append("data")
        if is_file(self.scene):
            needed.append("maps")
        return needed

    def _family(self) -> Family:
        from coopmap_env import families

        return families.get(str(self.family))

    def _family_kwargs(self) -> dict[str, Any]:
        """Arguments of the family, and those that it leaves free."""
        from coopmap_env.families import FREE_ARGUMENTS

        arguments = self._family().env_kwargs
        for option in fields(EnvironmentOptions):
            value = getattr(self, option.name)
            if option.name in FREE_ARGUMENTS:
                arguments[option.name] = value
            elif option.name != "family" and value not in (None, option.default):
                raise ValueError(
                    f"--{option.name.replace('_', '-')} belongs to --family {self.family}, which "
                    "has its own: leave it out"
                )
        return arguments

    def settings(self) -> Any:
        """Settings of the environment, or None for the defaults."""
        from coopmap_env.evaluation import get_env_spec

        if self.family is not None:
            return self._family().settings
        if not self.physics:
            return None
        return get_env_spec(self.env_name).settings_class(physics=self.physics)

    def make_env(self, split: str, **arguments: Any) -> MappingEnv[Any]:
        """Make the environment of a split, with further arguments that are no options."""
        from coopmap_env.evaluation import get_env_spec

        return get_env_spec(self.env_name).make(
            **self.env_kwargs(), split=split, settings=self.settings(), **arguments
        )


def parse_mounts(text: str) -> str | list[str]:
    """One mount for all robots, or a list with one for each if there is a comma."""
    for name in text.split(","):
        if name not in MOUNTS:
            raise ValueError(unknown("mount", name, MOUNTS))
    return text.split(",") if "," in text else text


def is_urdf(mount: str) -> bool:
    """Whether a mount is a file and no name."""
    return Path(mount).suffix.lower() in (".urdf", ".xml", ".xacro")


def is_file(scene: str | None) -> bool:
    """Whether a scene is a file and no name."""
    return scene is not None and Path(scene).suffix.lower() in (".yaml", ".yml")


def check_scene(scene: str, env_name: str) -> None:
    """Check that a scene is a file that exists, or a name.

    Raises
    ------
    ValueError
        If it is neither; with the choices.
    """
    if is_file(scene):
        if not Path(scene).is_file():
            raise ValueError(f"--scene {scene}: there is no such file")
    elif scene not in SCENES[env_name]:
        raise ValueError(
            f"{unknown('scene', scene, SCENES[env_name])}, or a path ending in .yaml or .yml"
        )
