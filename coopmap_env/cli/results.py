"""Where commands write without ``--out``, and what they say at their end."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

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
