"""The command `coopmap`: one file for each of its commands.

The commands of studies and of `coopmap_agents`, and those of other distributions, register
themselves under the entry-point group ``coopmap.commands``: dataclasses with a method `run`.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Protocol

from coopmap_env.cli.evaluate import Evaluate
from coopmap_env.cli.replay import Replay
from coopmap_env.core.extras import import_optional
from coopmap_env.core.progress import log

ENTRY_POINT_GROUP = "coopmap.commands"
BUILTIN_COMMANDS: dict[str, Any] = {
    "evaluate": Evaluate,
    "replay": Replay,
}
EXIT_INTERRUPTED = 130
"""What shells expect of a command that ended by an interrupt."""


class Command(Protocol):
    """What a command is, once its options are known."""

    def run(self) -> None:
        """Do it."""


def parse_command(arguments: list[str] | None = None) -> Command:
    """The command that the arguments (default: those of the process) ask for."""
    tyro = import_optional("tyro", "cli")
    command: Command = tyro.extras.subcommand_cli_from_dict(
        {
            **BUILTIN_COMMANDS,
            **{
                entry_point.name: entry_point.load()
                for entry_point in entry_points(group=ENTRY_POINT_GROUP)
            },
        },
        prog="coopmap",
        description="Cooperative active mapping: environments, planners, evaluation.",
        args=arguments,
    )
    return command


def main(arguments: list[str] | None = None) -> None:
    """Entry point: one clear line and exit status 1 on bad input."""
    try:
        parse_command(arguments).run()
    except KeyboardInterrupt:
        log("interrupted; what is finished is kept, the same command goes on with the rest")
        raise SystemExit(EXIT_INTERRUPTED) from None
    except (ValueError, ImportError, OSError) as error:
        raise SystemExit(f"coopmap: {' '.join(str(error).split())}") from None
