"""The command `coopmap`, with one file for each of its own commands.

More commands are registered under the entry-point group ``coopmap.commands``, as those of the
studies and of `coopmap_agents` are. A command is a dataclass with a method `run`.
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
"""Exit status of a command that was interrupted, by the convention of shells."""


class Command(Protocol):
    """A command with its options."""

    def run(self) -> None:
        """Run the command."""


def parse_command(arguments: list[str] | None = None) -> Command:
    """Parse the arguments (default: those of the process) into a command."""
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
    """Entry point; bad input prints one line and exits with status 1."""
    try:
        parse_command(arguments).run()
    except KeyboardInterrupt:
        log("interrupted; finished results are kept, and the same command resumes the run")
        raise SystemExit(EXIT_INTERRUPTED) from None
    except (ValueError, ImportError, OSError) as error:
        raise SystemExit(f"coopmap: {' '.join(str(error).split())}") from None
