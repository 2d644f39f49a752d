"""The command `coopmap`, with one file for each of its own commands.

More commands are registered under the entry-point group ``coopmap.commands``, as those of the
studies and of `coopmap_agents` are. A command is a dataclass with a method `run`; see `Command`.
A command is loaded when it is chosen, and it loads what it needs when it runs: a wrong name or
option is answered at once.
"""

from __future__ import annotations

import signal
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import cast

from coopmap_env.cli.commands import Command, find_commands, first_screen
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.cli.results import duration
from coopmap_env.core.choices import unknown
from coopmap_env.core.extras import require_extras
from coopmap_env.core.processes import exit_status, interrupted_by_signals
from coopmap_env.core.progress import log
from coopmap_env.core.version import __version__

__all__ = ["Command", "main", "parse_command"]

EXIT_INTERRUPTED = exit_status(signal.SIGINT)
EXIT_USAGE = 2
INTERRUPTED = "interrupted; finished results are kept, and the same command resumes the run"


def parse_command(arguments: Sequence[str] | None = None) -> Command:
    """Parse the arguments (default: those of the process) into a command.

    What asks for help or the version, or is no command, prints that and exits.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    commands = find_commands()
    name = given[0] if given else "--help"
    if name in ("-h", "--help"):
        print(first_screen(commands))
        raise SystemExit(0)
    if name == "--version":
        print(f"coopmap {__version__}")
        raise SystemExit(0)
    if name not in commands:
        print(f"coopmap: {unknown('command', name, commands)}", file=sys.stderr)
        raise SystemExit(EXIT_USAGE)
    from coopmap_env.cli.options import parse_options  # tyro

    return cast("Command", parse_options(commands[name](), f"coopmap {name}", given[1:]))


def main(arguments: Sequence[str] | None = None) -> None:
    """Entry point; bad input and a failure of the machine print one line and exit with status 1.

    A wrong command or option exits with 2, a signal (Ctrl-C, SIGTERM, SIGHUP) with 128 plus its
    number.
    """
    start = time.monotonic()
    out: Path | None = None
    try:
        with errors_as_lines(), interrupted_by_signals(INTERRUPTED):
            command = parse_command(arguments)
            out = getattr(command, "out", None)
            require_extras(getattr(command, "extras", list)())
            command.run()
            log(end_line(out, time.monotonic() - start))
    except KeyboardInterrupt as interruption:
        log(INTERRUPTED if out is None else f"{INTERRUPTED}, with --out {out}")
        raise SystemExit(getattr(interruption, "exit_status", EXIT_INTERRUPTED)) from None


def end_line(out: Path | None, seconds: float) -> str:
    """Where the results are, and how long a command took."""
    where = "" if out is None else f"; results: {out}"
    return f"done in {duration(seconds)}{where}"
