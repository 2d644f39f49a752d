"""Policies, clairvoyant references and upper bounds on the same training worlds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import Episode, Policy, make_policy, run_episode
from coopmap_env.evaluation.bounds import (
    BoundSearch,
    PlanarViews,
    bound_shown,
    efficiency,
    scans_in_time,
)
from coopmap_env.evaluation.statistics import Interval, bootstrap_mean
from coopmap_env.evaluation.tables import markdown_table
from coopmap_env.studies.clairvoyant.gap import split_gap
from coopmap_env.studies.clairvoyant.policy import (
    ClairvoyantGreedy,
    ClairvoyantLookAhead,
    LookAhead,
)

PLANNERS = {
    "random": "random",
    "rating, m = 100": "rating_function:search=100",
    "coverage, sequential, m = 300": "coverage:search=300+coordination=sequential",
    "frontier": "frontier",
}
"""Policies that do not know the truth, by their names in the table."""
GREEDY, LOOK_AHEAD = "clairvoyant, greedy", "clairvoyant, look-ahead"
COLUMNS = ("shown, %", "efficiency", "of area", "search", "knowledge", "information", "ms")


@dataclass(frozen=True)
class Played:
    """What was shown in one world."""

    bound: NDArray[np.int64]
    """Cells (n_scans + 1,)."""
    episodes: dict[str, Episode]
    """By policy."""
    n_cells: int
    """Of the world."""
    scan_time: float
    """Seconds."""

    def end(self, name: str) -> int:
        """Cells that a policy has shown at the end."""
        return self._cells(name, -1)

    @property
    def start(self) -> int:
        """Cells that are known at the start."""
        return self._cells(next(iter(self.episodes)), 0)

    def _cells(self, name: str, scan: int) -> int:
        curve = self.episodes[name].shown_curve
        assert curve is not None
        return round(curve[scan] * self.n_cells)


def play_worlds(
    env: PlanarEnv,
    seeds: Sequence[int],
    look_ahead: LookAhead,
    search: BoundSearch,
    log: Callable[[str], None],
) -> list[Played]:
    """Bound what can be shown in some worlds, and play all policies there.

    `env` is made with ``report_shown=True``.
    """
    policies: dict[str, Policy] = {name: make_policy(spec) for name, spec in PLANNERS.items()}
    policies[GREEDY] = ClairvoyantGreedy(env)
    policies[LOOK_AHEAD] = ClairvoyantLookAhead(env, look_ahead)
    worlds = []
    for seed in seeds:
        env.reset(seed=seed)
        n_cells, scan_time = env.truth.occupied.size, env.belief().scan_time
        n_scans = scans_in_time(env.max_scans, env.max_time, scan_time)
        bound = bound_shown(PlanarViews.from_env(env, n_scans), n_scans, search).bounds
        episodes = {name: run_episode(env, policy, seed) for name, policy in policies.items()}
        world = Played(bound, episodes, n_cells, scan_time)
        worlds.append(world)
        ends = ", ".join(f"{name} {world.end(name)}" for name in episodes)
        log(f"world {seed}: bound {bound[-1]}, {ends}")
    return worlds


def summarise(
    worlds: Sequence[Played], n_cells: int, rng: np.random.Generator
) -> dict[str, dict[str, Interval]]:
    """`COLUMNS` of each policy: means over the worlds with their 95 % intervals.

    The parts of the gap are those at the end. The best planner is the one that shows most in the
    mean; the clairvoyant of a world is the better one of the two.
    """
    ends = {name: _ends(worlds, name) for name in worlds[0].episodes}
    best = max(PLANNERS, key=lambda name: float(ends[name].mean()))
    clairvoyant = np.maximum(ends[GREEDY], ends[LOOK_AHEAD])
    start = np.array([world.start for world in worlds])
    bound = np.array([world.bound[-1] for world in worlds])
    table = {}
    for name, end in ends.items():
        gap = split_gap(start, bound, clairvoyant, ends[best], end)
        areas = [
            efficiency(world.episodes[name], world.bound, world.n_cells, world.scan_time).area
            for world in worlds
        ]
        times = [world.episodes[name].planning_time_ms for world in worlds]
        columns: tuple[ArrayLike, ...] = (
            100.0 * end / n_cells,
            gap.efficiency,
            areas,
            *gap[1:],
            times,
        )
        table[name] = {
            column: bootstrap_mean(values, rng)
            for column, values in zip(COLUMNS, columns, strict=True)
        }
    return table


def _ends(worlds: Sequence[Played], name: str) -> NDArray[np.int64]:
    return np.array([world.end(name) for world in worlds])


def table_lines(table: Mapping[str, Mapping[str, Interval]]) -> list[str]:
    """The table as Markdown."""
    digits = [".1f", *[".3f"] * (len(COLUMNS) - 2), ".0f"]
    rows = [["policy", *COLUMNS]]
    for name, row in table.items():
        cells = [f"{row[column]:{own}}" for column, own in zip(COLUMNS, digits, strict=True)]
        rows.append([name, *cells])
    return markdown_table(rows).splitlines()
