"""The command; see the package's page."""

from __future__ import annotations

import argparse
from dataclasses import fields, replace
from typing import Any

import numpy as np

from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.progress import log
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import get_env_spec
from coopmap_env.evaluation.bounds import BoundSearch
from coopmap_env.studies.clairvoyant import LookAhead, play_worlds, summarise, table_lines
from coopmap_env.studies.common.scenes import parse_scene


def main(arguments: list[str] | None = None) -> None:
    """Play all policies on training worlds and print the table."""
    parser = argparse.ArgumentParser(
        prog="python -m coopmap_env.studies.clairvoyant",
        description="How much policies show beside ones that know the world, and upper bounds.",
    )
    parser.add_argument(
        "scene", help='name, or JSON such as {"name": "obstacles", "shape": [80, 80]}'
    )
    parser.add_argument("--scans", type=int, default=16, help="of each robot")
    parser.add_argument("--worlds", type=int, default=5, help="training worlds, two or more")
    parser.add_argument("--first", type=int, default=0, help="seed of the first one")
    parser.add_argument("--robots", type=int, default=2)
    parser.add_argument("--candidates", type=int, default=0, help="m; 0: any pose")
    parser.add_argument("--reach", type=float, help="metres")
    parser.add_argument("--rounds", type=int, default=BoundSearch().n_rounds, help="of the bound")
    for field in fields(LookAhead):
        name = f"--{field.name.replace('_', '-')}"
        parser.add_argument(name, type=int, default=field.default, help="of LookAhead")
    options = parser.parse_args(arguments)
    env = make_env(options)
    look_ahead = LookAhead(
        **{field.name: getattr(options, field.name) for field in fields(LookAhead)}
    )
    seeds = range(options.first, options.first + options.worlds)
    worlds = play_worlds(env, seeds, look_ahead, BoundSearch(n_rounds=options.rounds), log)
    n_cells = env.belief().map.grid.n_cells
    print("\n".join(table_lines(summarise(worlds, n_cells, np.random.default_rng(0)))))


def make_env(options: argparse.Namespace) -> PlanarEnv:
    """The environment of the options, on training worlds."""
    given: dict[str, Any] = {
        "scene": parse_scene(options.scene),
        "max_scans": options.scans,
        "n_robots": options.robots,
        "split": "train",
        "report_shown": True,
    }
    if options.candidates:
        given |= {"action_mode": "candidates", "n_candidates": options.candidates}
    make = get_env_spec("planar").make
    if options.reach is not None:
        given["settings"] = replace(make(**given).settings, reach=options.reach)
    env = make(**given)
    assert isinstance(env, PlanarEnv)
    return env


if __name__ == "__main__":
    with errors_as_lines("clairvoyant"):
        main()
