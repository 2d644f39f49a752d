"""Evaluate one policy in this process, or compare many on the same worlds in worker processes."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import write_atomically
from coopmap_env.envs import MappingEnv
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation.bounds import Efficiency, WorldBound, bound_worlds, efficiency
from coopmap_env.evaluation.env_specs import get_env_spec
from coopmap_env.evaluation.episode import Episode, episode_from_dict, run_episode
from coopmap_env.evaluation.episode_jobs import make_job, run_job
from coopmap_env.evaluation.jobs import Backend, run_jobs
from coopmap_env.evaluation.policy import Policy, make_policy
from coopmap_env.evaluation.rollout import warm_up
from coopmap_env.evaluation.stored_episode import is_episode

EFFICIENCY_SCORES = ("efficiency", "efficiency_auc")
"""Columns where bounds are known: efficiency at the end, and of the area under the curve."""


@dataclass(frozen=True)
class Evaluation:
    """Episodes of one policy, one for each seed."""

    episodes: tuple[Episode, ...]
    efficiencies: tuple[Efficiency, ...] | None = None
    """Of the episodes, where the bounds of their worlds are known."""

    @property
    def table(self) -> dict[str, NDArray[np.float64]]:
        """Scores by column, each of shape (n_episodes,)."""
        rows = self.rows
        return {key: np.array([row[key] for row in rows]) for key in rows[0]}

    @property
    def rows(self) -> list[dict[str, float]]:
        """Scores of each episode by column."""
        rows = [episode.row() for episode in self.episodes]
        if self.efficiencies is None:
            return rows
        return [
            {**row, **dict(zip(EFFICIENCY_SCORES, own, strict=True))}
            for row, own in zip(rows, self.efficiencies, strict=True)
        ]

    def with_bounds(
        self, bounds: Sequence[NDArray[np.int64]], n_cells: int, scan_time: float
    ) -> Evaluation:
        """The same with the efficiency of each episode; see `evaluation.bounds.efficiency`."""
        own = (
            efficiency(episode, most, n_cells, scan_time)
            for episode, most in zip(self.episodes, bounds, strict=True)
        )
        return Evaluation(self.episodes, tuple(own))

    @property
    def curves(self) -> dict[str, NDArray[np.float64]]:
        """Curves by name, each of shape (n_episodes, n_scans + 1), from before the first scan.

        Those of an episode that time has ended earlier than others go on level.
        """
        curves = {
            "coverage": [e.coverage_curve for e in self.episodes],
            "entropy": [e.entropy_curve for e in self.episodes],
            "surface_coverage": [e.surface.coverage_curve for e in self.episodes if e.surface],
            "shown": [e.shown_curve for e in self.episodes if e.shown_curve is not None],
        }
        return {name: _rows_of_equal_length(own) for name, own in curves.items() if own}


def _rows_of_equal_length(curves: Sequence[list[float]]) -> NDArray[np.float64]:
    """Curves as the rows of an array, shorter ones with their last value to the end."""
    n = max(map(len, curves))
    return np.array([curve + curve[-1:] * (n - len(curve)) for curve in curves])


def evaluate(env: MappingEnv[Any], policy: Policy, seeds: Iterable[int]) -> Evaluation:
    """Play one episode on the world of each seed of the environment's split.

    Parameters
    ----------
    env : MappingEnv
        Made by `coopmap_env.planar_v1.parallel_env` or `coopmap_env.field_v1.parallel_env`.
    policy : Policy
        A baseline, a learned policy or any other.
    seeds : iterable of int

    Raises
    ------
    ValueError
        If there is no seed, or the policy has no `reset` and `act`.
    """
    if not isinstance(policy, Policy):
        raise ValueError(f"a policy needs the methods reset and act, got {policy!r}")
    seeds = list(seeds)
    if not seeds:
        raise ValueError("evaluate needs at least one seed")
    warm_up(env, policy)
    return Evaluation(tuple(run_episode(env, policy, seed) for seed in seeds))


def compare(
    policies: Sequence[str],
    seeds: Sequence[int],
    env_kwargs: dict[str, Any],
    results_dir: Path,
    settings: Any = None,
    workers: int = 1,
    progress: bool = True,
    env_name: str = "planar",
    backend: Backend = "processes",
) -> dict[str, Evaluation]:
    """Play every policy on the same worlds.

    An interrupted or killed comparison can be resumed; stored episodes that are damaged are played
    again. Results do not depend on the number of workers, except
    for planning times.

    Parameters
    ----------
    policies : sequence of str
        Specs, see `make_policy`.
    seeds : sequence of int
    env_kwargs : dict
        Arguments of the environment as JSON values, without the settings.
    results_dir : Path
        Folder for finished episodes.
    settings : optional
        `PlanarSettings` or `FieldSettings`. Stored episodes belong to the settings that they were
        played with, also if these are the defaults: other defaults play again.
    env_name : {"planar", "field"}
    backend : {"processes", "ray"}
        Kind of the workers; see `run_jobs`.
    """
    # bad specs and arguments are rejected before any episode is played
    policy_objects = [make_policy(policy) for policy in policies]
    with closing(get_env_spec(env_name).make(**env_kwargs, settings=settings)) as trial_env:
        warm_up(trial_env, *policy_objects)
        settings = trial_env.settings  # the defaults may depend on the scene
        is_valid = partial(
            is_episode,
            n_scans=trial_env.max_scans,
            with_surface=isinstance(trial_env, FieldEnv),
            with_shown=True,
        )
    jobs = [
        make_job(policy, seed, env_kwargs, settings, env_name)
        for seed in seeds  # policies share the evaluator of a world
        for policy in policies
    ]
    results = run_jobs(run_job, jobs, results_dir, workers, progress, is_valid, backend)
    return {
        policy: Evaluation(tuple(map(episode_from_dict, results[k :: len(policies)])))
        for k, policy in enumerate(policies)
    }


def with_efficiencies(
    evaluations: Mapping[str, Evaluation],
    seeds: Sequence[int],
    env_kwargs: dict[str, Any],
    bounds_dir: Path,
    settings: Any = None,
    workers: int = 1,
    progress: bool = True,
    env_name: str = "planar",
) -> dict[str, Evaluation]:
    """Evaluations with the efficiency of each episode; see `evaluation.bounds.efficiency`.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
        Played on the worlds of `seeds`, as by `compare`.
    seeds, env_kwargs, settings, workers, progress, env_name
        As of `compare`.
    bounds_dir : Path
        Keeps the bounds and their certificates; see `bound_worlds`.

    Raises
    ------
    ValueError
        If the environment is not planar: other worlds have no bound that holds for all policies.
    """
    bounds = bound_worlds(seeds, env_kwargs, bounds_dir, settings, workers, progress, env_name)
    with closing(get_env_spec(env_name).make(**env_kwargs, settings=settings)) as env:
        env.reset(seed=seeds[0])
        return with_world_bounds(evaluations, bounds, env)


def with_world_bounds(
    evaluations: Mapping[str, Evaluation], bounds: Sequence[WorldBound], env: MappingEnv[Any]
) -> dict[str, Evaluation]:
    """Evaluations with efficiencies by bounds that are known.

    Parameters
    ----------
    evaluations : mapping of str to Evaluation
    bounds : sequence of WorldBound
        Of the worlds of each evaluation, in their order.
    env : MappingEnv
        Of these worlds, after a reset.
    """
    most, belief = [own.bounds for own in bounds], env.belief()
    return {
        name: evaluation.with_bounds(most, belief.map.grid.n_cells, belief.scan_time)
        for name, evaluation in evaluations.items()
    }


def write_episodes(evaluations: dict[str, Evaluation], path: Path) -> None:
    """One CSV row per policy and world."""
    text = io.StringIO()
    writer: Any = None
    for name, evaluation in evaluations.items():
        for scores in evaluation.rows:
            row = {"policy": name, **scores}
            if writer is None:
                writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow(row)
    write_atomically(path, text.getvalue())
