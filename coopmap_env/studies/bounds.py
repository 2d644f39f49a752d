"""How much can be shown at all, and how near to it the known bounds are.

::

    python -m coopmap_env.studies.bounds obstacles --scans 64 --seeds 0 1 2
    python -m coopmap_env.studies.bounds '{"name": "obstacles", "shape": [64, 64]}' --scans 16

prints a row for each world, and their means: cells that are known at the start, the bound after the
last scan, what the choice shows, the gap between both, and seconds of CPU time of the search.
With ``--out FOLDER``, the bounds are kept as FOLDER/SEED.npz (`load_bound` reads them).
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.progress import log as log_line
from coopmap_env.evaluation import get_env_spec
from coopmap_env.evaluation.bounds import BoundSearch, PlanarViews, bound_shown, save_bound
from coopmap_env.studies.common.scenes import parse_scene

FEWEST = BoundSearch(n_exchanges=0, n_rounds=1, tolerance=0.0)
"""A search that loads all kernels."""


class Row(NamedTuple):
    """The bound of one world, or means over worlds."""

    seed: str
    known: float
    """Cells at the start."""
    bound: float
    """Cells after the last scan."""
    choice: float
    """Cells that the choice shows then."""
    gap: float
    """bound / choice - 1."""
    seconds: float
    """CPU time of the search."""


def bound_world(
    scene: str | dict[str, Any],
    n_scans: int,
    seed: int,
    split: str = "train",
    n_robots: int = 2,
    search: BoundSearch | None = None,
    log: Callable[[str], None] | None = None,
    out: Path | None = None,
) -> Row:
    """Bound what can be shown in a world.

    Parameters
    ----------
    scene : str or dict
        See `coopmap_env.evaluation.env_specs.EnvSpec.make`.
    n_scans : int
        Of each robot.
    seed : int
    split : str
    n_robots : int
    search : BoundSearch, optional
    log : callable, optional
        Receives a line of progress after each round.
    out : Path, optional
        Folder for a file of the bound.

    Raises
    ------
    ValueError
        If the environment does not accept an argument.
    """
    env = get_env_spec("planar").make(
        scene=scene, split=split, n_robots=n_robots, max_scans=n_scans
    )
    env.reset(seed=seed)
    views = PlanarViews.from_env(env)
    bound_shown(views, n_scans, FEWEST)
    start = time.process_time()
    found = bound_shown(views, n_scans, search, log)
    seconds = time.process_time() - start
    if out is not None:
        save_bound(out / f"{seed}.npz", found, views)
    known, bound, choice = found.bounds[0], found.bounds[-1], found.choice_shown[-1]
    return Row(str(seed), int(known), int(bound), int(choice), found.gap, seconds)


def mean_row(rows: Sequence[Row]) -> Row:
    """Means of all columns."""
    return Row("mean", *np.mean([row[1:] for row in rows], axis=0).tolist())


def format_row(row: Row) -> str:
    """A line of the table."""
    cells = "".join(f"{value:10,.0f}" for value in (row.known, row.bound, row.choice))
    return f"{row.seed:>8}{cells}{row.gap:8.2%}{row.seconds:8.1f}"


def main(arguments: list[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.bounds",
        description="Bound how many cells can be shown in planar worlds.",
    )
    parser.add_argument("scene", help="a name, or a JSON object of a scene's name and fields")
    parser.add_argument("--scans", type=int, default=64, help="of each robot")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2], help="of the worlds")
    parser.add_argument("--split", default="train", help="of the seeds: train, validation or test")
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--out", type=Path, help="folder for the bounds, as SEED.npz")
    parser.add_argument("--progress", action="store_true", help="a line after each round")
    options = parser.parse_args(arguments)
    scene = parse_scene(options.scene)
    titles = "".join(f"{title:>10}" for title in ("known", "bound", "choice"))
    print(f"{'seed':>8}{titles}{'gap':>8}{'seconds':>8}")
    rows = []
    for seed in options.seeds:
        log = log_line if options.progress else None
        rows.append(
            bound_world(
                scene, options.scans, seed, options.split, options.robots, None, log, options.out
            )
        )
        print(format_row(rows[-1]), flush=True)
    print(format_row(mean_row(rows)))


if __name__ == "__main__":
    with errors_as_lines("bounds"):
        main()
