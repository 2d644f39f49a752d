"""Options of studies that play policies on worlds and write a page."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from coopmap_env.simulation.scenes import SPLITS


def parse_world_options(
    prog: str, description: str, arguments: Sequence[str] | None
) -> argparse.Namespace:
    """Parse ``split``, ``worlds``, ``workers``, ``out`` and ``page``; wrong ones exit with 2."""
    parser = argparse.ArgumentParser(prog=prog, description=description)
    parser.add_argument("--split", choices=SPLITS, default="test")
    parser.add_argument("--worlds", type=int, default=20, help="two or more, from seed 0 on")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--out", type=Path, required=True, help="folder of episodes and bounds")
    parser.add_argument("--page", type=Path, help="file of the page")
    options = parser.parse_args(arguments)
    if options.worlds < 2:
        parser.error(f"--worlds must be at least 2, got {options.worlds}")
    return options
