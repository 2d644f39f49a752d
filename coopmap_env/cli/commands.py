"""The commands by name, loaded when they are chosen, and the screen that lists them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, ClassVar, Protocol

ENTRY_POINT_GROUP = "coopmap.commands"
BUILTIN_COMMANDS = {
    "evaluate": "coopmap_env.cli.evaluate:Evaluate",
    "record": "coopmap_env.cli.record:Record",
    "replay": "coopmap_env.cli.replay:Replay",
    "report": "coopmap_env.cli.report:Report",
    "warm-up": "coopmap_env.cli.warm_up:WarmUp",
}
"""Class of each command of this package."""
PURPOSES = (
    "play and compare policies",
    "train policies",
    "benchmark families",
    "studies of the paper and of this benchmark",
    "this machine",
)
"""Groups of the commands on the first screen, in this order; those of others follow."""
OTHER = "other packages"


class Command(Protocol):
    """A command with its options: a dataclass.

    It may also have ``PURPOSE: ClassVar[str]``, its group on the first screen, ``extras()``, names
    of the extras that it needs with its options, and ``out``, the path of its results.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]

    def run(self) -> None:
        """Run the command."""


Loader = Callable[[], Any]


def find_commands() -> dict[str, Loader]:
    """What loads the class of each command."""
    builtin: dict[str, Loader] = {
        name: partial(_load, target) for name, target in BUILTIN_COMMANDS.items()
    }
    found = {entry_point.name: entry_point.load for entry_point in _registered()}
    return {**builtin, **found}


def first_screen(commands: dict[str, Loader]) -> str:
    """All commands by purpose, with the first sentence of each."""
    groups: dict[str, list[str]] = {purpose: [] for purpose in PURPOSES}
    width = max(map(len, commands))
    for name, load in commands.items():
        purpose, text = _describe(load)
        groups.setdefault(purpose, []).append(f"  {name:<{width}}  {text}")
    parts = [
        "usage: coopmap COMMAND [OPTIONS]",
        "Cooperative active mapping: environments, planners, evaluation.",
        *("\n".join([f"{purpose}:", *lines]) for purpose, lines in groups.items() if lines),
        "coopmap COMMAND --help lists the options of a command, coopmap --version the version.",
    ]
    return "\n\n".join(parts)


def _describe(load: Loader) -> tuple[str, str]:
    """Group and first sentence of a command."""
    try:
        command = load()
    except Exception as error:  # of another distribution: the others are listed all the same
        return OTHER, f"(cannot be loaded: {error})"
    text = (command.__doc__ or "").partition("\n")[0]
    return getattr(command, "PURPOSE", OTHER), text


def _load(target: str) -> Any:
    module, _, name = target.partition(":")
    return getattr(import_module(module), name)


def _registered() -> Iterable[Any]:
    return entry_points(group=ENTRY_POINT_GROUP)
