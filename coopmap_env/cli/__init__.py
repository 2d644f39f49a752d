"""The command `coopmap`: one file for each of its commands."""

from __future__ import annotations

from coopmap_env.cli.bench import Bench
from coopmap_env.cli.evaluate import Evaluate
from coopmap_env.cli.localization import Localization
from coopmap_env.cli.output import say
from coopmap_env.cli.replay import Replay
from coopmap_env.cli.reproduce import Reproduce
from coopmap_env.extras import require

Command = Reproduce | Evaluate | Localization | Replay | Bench
INTERRUPTED = 130
"""What shells expect of a command that ended by an interrupt."""


def parse(arguments: list[str] | None = None) -> Command:
    """The command that the arguments (default: those of the process) ask for."""
    tyro = require("tyro", "cli")
    command: Command = tyro.extras.subcommand_cli_from_dict(
        {
            "reproduce": Reproduce,
            "evaluate": Evaluate,
            "localization": Localization,
            "replay": Replay,
            "bench": Bench,
        },
        prog="coopmap",
        description="Cooperative active mapping: environments, planners, evaluation.",
        args=arguments,
    )
    return command


def main(arguments: list[str] | None = None) -> None:
    """Entry point: one clear line and exit status 1 on bad input."""
    try:
        parse(arguments).run()
    except KeyboardInterrupt:
        say("interrupted; finished episodes are kept, the same command goes on with the rest")
        raise SystemExit(INTERRUPTED) from None
    except (ValueError, ImportError, OSError) as error:
        raise SystemExit(f"coopmap: {' '.join(str(error).split())}") from None
