"""The command `coopmap`, with one file for each of its own commands.

More commands are registered under the entry-point group ``coopmap.commands``, as those of the
studies and of `coopmap_agents` are. A command is a dataclass with a method `run`.
"""

from __future__ import annotations

import os
import signal
import sys
from importlib.metadata import entry_points
from typing import Any, Protocol

from coopmap_env.cli.evaluate import Evaluate
from coopmap_env.cli.replay import Replay
from coopmap_env.core.extras import import_optional
from coopmap_env.core.processes import WorkerError, exit_status, interrupted_by_signals
from coopmap_env.core.progress import log

ENTRY_POINT_GROUP = "coopmap.commands"
BUILTIN_COMMANDS: dict[str, Any] = {
    "evaluate": Evaluate,
    "replay": Replay,
}
EXIT_INTERRUPTED = exit_status(signal.SIGINT)
INTERRUPTED = "interrupted; finished results are kept, and the same command resumes the run"


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
    """Entry point; bad input and a failure of the machine print one line and exit with status 1.

    A signal (Ctrl-C, SIGTERM, SIGHUP) exits with 128 plus its number.
    """
    try:
        with interrupted_by_signals(INTERRUPTED):
            parse_command(arguments).run()
    except KeyboardInterrupt as interruption:
        log(INTERRUPTED)
        raise SystemExit(getattr(interruption, "exit_status", EXIT_INTERRUPTED)) from None
    except BrokenPipeError:  # the reader of our output has ended, as `head` does
        with open(os.devnull, "w") as nowhere:
            os.dup2(nowhere.fileno(), sys.stdout.fileno())
        raise SystemExit(1) from None
    except (ValueError, ImportError, OSError, WorkerError) as error:
        raise SystemExit(one_line(error)) from None
    except (MemoryError, RuntimeError) as error:
        if not is_out_of_memory(error):
            raise
        raise SystemExit(f"{one_line(error)}: memory is short; use fewer workers") from None


def one_line(error: BaseException) -> str:
    """The message of an error, for the terminal."""
    return f"coopmap: {' '.join(str(error).split()) or type(error).__name__}"


def is_out_of_memory(error: BaseException) -> bool:
    """Whether memory was short; torch raises a RuntimeError."""
    return isinstance(error, MemoryError) or any(
        text in str(error) for text in ("can't allocate memory", "out of memory")
    )
