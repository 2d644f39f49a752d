"""Where commands write without ``--out``, what they say at their end, and how to repeat them."""

from __future__ import annotations

import shlex
from dataclasses import MISSING, fields
from datetime import datetime
from pathlib import Path
from typing import Any

RESULTS = Path("results")


def new_results_path(command: str, suffix: str = "", now: datetime | None = None) -> Path:
    """A path that nothing has: ``results/COMMAND-TIME``, such as results/evaluate-20261130-184501.

    Parameters
    ----------
    command : str
    suffix : str
        Of a file; a folder has none.
    now : datetime, optional
        The present time by default.
    """
    name = f"{command}-{now or datetime.now():%Y%m%d-%H%M%S}"
    names = [name, *(f"{name}-{k}" for k in range(2, 1000))]
    paths = [RESULTS / f"{each}{suffix}" for each in names]
    return next((path for path in paths if not path.exists()), paths[-1])


def command_line(name: str, command: Any) -> str:
    """The line that runs a command with the same options; those at their defaults are left out.

    Parameters
    ----------
    name : str
        Of the command, such as "evaluate".
    command : dataclass
        With its options as fields.
    """
    words = ["coopmap", name]
    for option in fields(command):
        value = getattr(command, option.name)
        if option.default is not MISSING and value == option.default:
            continue
        spelled = option.name.replace("_", "-")
        if isinstance(value, bool):
            words.append(f"--{spelled}" if value else f"--no-{spelled}")
        else:
            words.append(f"--{spelled}")
            words += map(str, value) if isinstance(value, tuple) else [str(value)]
    return shlex.join(words)


def duration(seconds: float) -> str:
    """Seconds for readers, such as "3 min 20 s"."""
    if seconds < 9.95:
        return f"{seconds:.1f} s"
    whole = round(seconds)
    if whole < 60:
        return f"{whole} s"
    if whole < 3600:
        return f"{whole // 60} min {whole % 60} s"
    return f"{whole // 3600} h {whole % 3600 // 60} min"
