"""Evaluate one policy in process, or compare many on the same worlds in worker processes."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import re
from collections.abc import Iterable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.files import write_atomically
from coopmap_env.core.serial import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.evaluation.jobs import Engine, Job, Result, run_jobs
from coopmap_env.evaluation.policy import Policy, make_policy
from coopmap_env.evaluation.rollout import (
    SURFACE_SCORES,
    Episode,
    episode_from_dict,
    run_episode,
    warm_up,
)
from coopmap_env.evaluation.statistics.bootstrap import (
    bootstrap_interquartile_mean,
    bootstrap_mean,
    bootstrap_paired_difference,
    probability_of_improvement,
)
from coopmap_env.evaluation.worlds import kind_of, make_env
from coopmap_env.simulation.scenes.field import read_user_scene

SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "entropy",
    "log_loss",
    "brier",
    "motion_cost",
    "contacts",
    "planning_ms",
    *SURFACE_SCORES,
)
"""Columns that the summary gives with intervals, those of them that the world has."""
BOOTSTRAP_SEED = 20_011
OF_POLICY = ("policy", "fingerprint", "seed")
"""Entries of a job that do not decide its environment."""


@dataclass(frozen=True)
class Evaluation:
    """Episodes of one policy, one for each seed."""

    episodes: tuple[Episode, ...]

    @property
    def table(self) -> dict[str, NDArray[np.float64]]:
        """Scores by column, each of shape (n_episodes,)."""
        rows = [episode.row() for episode in self.episodes]
        return {key: np.array([row[key] for row in rows]) for key in rows[0]}

    @property
    def curves(self) -> dict[str, NDArray[np.float64]]:
        """Curves by name, each of shape (n_episodes, n_scans + 1), beginning before a scan."""
        curves = {
            "viewed": np.array([episode.viewed for episode in self.episodes]),
            "entropy": np.array([episode.entropy for episode in self.episodes]),
        }
        traces = [episode.surface.curve for episode in self.episodes if episode.surface]
        return {**curves, "surface": np.array(traces)} if traces else curves


def evaluate(env: MappingEnv[Any], policy: Policy, seeds: Iterable[int]) -> Evaluation:
    """Play one episode on the world of each seed of the environment's split.

    Parameters
    ----------
    env : MappingEnv
        Made by `coopmap_env.planar_v0.parallel_env` or `coopmap_env.field_v0.parallel_env`.
    policy : Policy
        A baseline, a learned policy, or one's own.
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


def make_job(
    policy: str, seed: int, env: dict[str, Any], settings: Any, world: str = "planar"
) -> Job:
    """One episode as JSON: all that decides it, so that equal jobs have equal results.

    Files that an option of the policy names count by their content, and so does a scene's file with
    all that it names: images, meshes, URDFs. A policy with a `fingerprint` counts by it too: what
    it has learned can be another under the same name.
    """
    return {
        "version": __version__,
        "files": contents_of(policy, str(env.get("scene", "")), world),
        "policy": policy,
        "fingerprint": _fingerprint(policy),
        "seed": seed,
        "world": world,
        "env": env,
        "settings": None if settings is None else settings_to_dict(settings),
    }


@lru_cache(maxsize=64)
def _fingerprint(policy: str) -> str:
    return str(getattr(make_policy(policy), "fingerprint", ""))


def contents_of(policy: str, scene: str, world: str) -> dict[str, str]:
    """SHA-256 of the files that a policy's spec names, and of a scene's."""
    named = [Path(word) for word in re.split("[=+:]", policy) if word]
    return _hashes(named) | _scene_contents(scene, world)


def _scene_contents(scene: str, world: str) -> dict[str, str]:
    """SHA-256 of a scene's YAML and image, or in the field of the solids that come of its files."""
    path = Path(scene)
    if path.suffix not in (".yaml", ".yml"):
        return {}
    if world == "planar":
        return _hashes([path, *path.parent.glob("*.p[gn][mg]")])
    sha = hashlib.sha256(path.read_bytes())
    for solid in read_user_scene(path).solids:
        sha.update(solid.vertices.tobytes() + solid.faces.tobytes())
    return {scene: sha.hexdigest()}


def _hashes(paths: Sequence[Path]) -> dict[str, str]:
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()
    }


@lru_cache(maxsize=4)
def _env(arguments: str) -> MappingEnv[Any]:
    values = json.loads(arguments)
    return make_env(values["world"], values["env"], values["settings"])


@lru_cache(maxsize=16)
def _policy(spec: str, arguments: str) -> Policy:
    policy = make_policy(spec)
    warm_up(_env(arguments), policy)
    return policy


def run_job(job: Job) -> Result:
    """Play the episode of a job; environments and policies are kept from job to job."""
    kept = {name: value for name, value in job.items() if name not in OF_POLICY}
    arguments = json.dumps(kept, sort_keys=True)
    return asdict(run_episode(_env(arguments), _policy(job["policy"], arguments), job["seed"]))


def _is_episode(result: Any) -> bool:
    """Whether a stored result is an episode of this version."""
    try:
        episode_from_dict(result)
    except (TypeError, KeyError):
        return False
    return True


def compare(
    policies: Sequence[str],
    seeds: Sequence[int],
    env: dict[str, Any],
    store: Path,
    settings: Any = None,
    workers: int = 1,
    progress: bool = True,
    world: str = "planar",
    engine: Engine = "processes",
) -> dict[str, Evaluation]:
    """Play every policy on the same worlds; resumable, and the same for any number of workers.

    Parameters
    ----------
    policies : sequence of str
        Specs, see `make_policy`.
    seeds : sequence of int
    env : dict
        Arguments of the environment as JSON values, without the settings.
    store : Path
        Folder for finished episodes.
    settings : optional
        `PlanarSettings` or `FieldSettings`.
    world : {"planar", "field"}
    engine : {"processes", "ray"}
        What the workers are; see `coopmap_env.evaluation.jobs.run_jobs`.
    """
    made = [make_policy(policy) for policy in policies]  # refuses bad specs before any work
    with closing(kind_of(world).env(**env, settings=settings)) as tried:  # and bad arguments
        _try_out(made, tried)
    jobs = [make_job(policy, seed, env, settings, world) for policy in policies for seed in seeds]
    results = iter(run_jobs(run_job, jobs, store, workers, progress, _is_episode, engine))
    return {
        policy: Evaluation(tuple(episode_from_dict(next(results)) for _ in seeds))
        for policy in policies
    }


def _try_out(policies: Iterable[Policy], env: MappingEnv[Any]) -> None:
    """Let each decide once, so that one that does not fit is found out before others play."""
    observations, _ = env.reset(seed=0)
    for policy in policies:
        policy.reset(np.random.default_rng(0))
        policy.act(env.belief(), observations)


def summarize(evaluations: dict[str, Evaluation], reference: str | None) -> dict[str, Any]:
    """Scores of each policy with 95 % intervals, and how it fares against a reference policy.

    For every score: the mean, and the interquartile mean with its stratified bootstrap interval
    (the worlds of a policy are one stratum).
    Against the reference, over the paired worlds: the probability of improvement and the mean
    difference in the area under the coverage curve.
    """
    summary: dict[str, Any] = {}
    for name, evaluation in evaluations.items():
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        table = evaluation.table
        entry: dict[str, Any] = {"episodes": len(evaluation.episodes)}
        if len(evaluation.episodes) > 1:
            for score in (score for score in SCORES if score in table):
                entry[score] = {
                    "mean": bootstrap_mean(table[score], rng).as_dict(),
                    "interquartile_mean": bootstrap_interquartile_mean(
                        [table[score]], rng
                    ).as_dict(),
                }
            if reference is not None and name != reference:
                ours, theirs = table["coverage_auc"], evaluations[reference].table["coverage_auc"]
                entry["against"] = {
                    "policy": reference,
                    "score": "coverage_auc",
                    "probability_of_improvement": probability_of_improvement(
                        ours, theirs, rng
                    ).as_dict(),
                    "difference": bootstrap_paired_difference(ours, theirs, rng).as_dict(),
                }
        summary[name] = entry
    return summary


def write_episodes(evaluations: dict[str, Evaluation], path: Path) -> None:
    """One CSV row per policy and world."""
    text = io.StringIO()
    writer: Any = None
    for name, evaluation in evaluations.items():
        for episode in evaluation.episodes:
            row = {"policy": name, **episode.row()}
            if writer is None:
                writer = csv.DictWriter(text, fieldnames=list(row), lineterminator="\n")
                writer.writeheader()
            writer.writerow(row)
    write_atomically(path, text.getvalue())
