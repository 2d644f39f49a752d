"""Evaluate one policy in this process, or compare many on the same worlds in worker processes."""

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
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation.env_specs import get_env_spec, make_env
from coopmap_env.evaluation.episode import (
    SURFACE_SCORES,
    Episode,
    episode_from_dict,
    run_episode,
)
from coopmap_env.evaluation.jobs import Backend, Job, Result, run_jobs
from coopmap_env.evaluation.policy import Policy, make_policy
from coopmap_env.evaluation.rollout import warm_up
from coopmap_env.evaluation.statistics import (
    bootstrap_interquartile_mean,
    bootstrap_mean,
    bootstrap_paired_difference,
    probability_of_improvement,
)
from coopmap_env.simulation.scenes.field import read_user_scene

SUMMARY_SCORES = (
    "coverage",
    "coverage_auc",
    "reward",
    "entropy",
    "log_loss",
    "brier_score",
    "motion_distance",
    "n_collisions",
    "planning_time_ms",
    *SURFACE_SCORES,
)
"""Columns that the summary gives with intervals, if the environment has them."""
BOOTSTRAP_SEED = 20_011
POLICY_KEYS = ("policy", "fingerprint", "seed")
"""Entries of a job that its environment does not depend on."""


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
        """Curves by name, each of shape (n_episodes, n_scans + 1), from before the first scan."""
        curves = {
            "coverage": np.array([episode.coverage_curve for episode in self.episodes]),
            "entropy": np.array([episode.entropy_curve for episode in self.episodes]),
        }
        traces = [episode.surface.coverage_curve for episode in self.episodes if episode.surface]
        return {**curves, "surface_coverage": np.array(traces)} if traces else curves


def evaluate(env: MappingEnv[Any], policy: Policy, seeds: Iterable[int]) -> Evaluation:
    """Play one episode on the world of each seed of the environment's split.

    Parameters
    ----------
    env : MappingEnv
        Made by `coopmap_env.planar_v0.parallel_env` or `coopmap_env.field_v0.parallel_env`.
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


def make_job(
    policy: str, seed: int, env_kwargs: dict[str, Any], settings: Any, env_name: str = "planar"
) -> Job:
    """One episode as JSON values. They determine its result: equal jobs have equal results.

    Files that are named by the policy's options or by the scene (its YAML file, images, meshes and
    URDFs) enter by the hash of their content. So does the `fingerprint` of a policy that has one:
    learned weights can change under the same name.

    Parameters
    ----------
    policy : str
        Spec, see `make_policy`.
    seed : int
    env_kwargs : dict
        Arguments of the environment as JSON values, without the settings.
    settings : PlanarSettings or FieldSettings, optional
    env_name : {"planar", "field"}
    """
    return {
        "version": __version__,
        "files": file_hashes(policy, str(env_kwargs.get("scene", "")), env_name),
        "policy": policy,
        "fingerprint": _fingerprint(policy),
        "seed": seed,
        "env_name": env_name,
        "env_kwargs": env_kwargs,
        "settings": None if settings is None else settings_to_dict(settings),
    }


@lru_cache(maxsize=64)
def _fingerprint(policy: str) -> str:
    return str(getattr(make_policy(policy), "fingerprint", ""))


def file_hashes(policy: str, scene: str, env_name: str) -> dict[str, str]:
    """SHA-256 of the files that a policy's spec and a scene name, by path."""
    named = [Path(word) for word in re.split("[=+:]", policy) if word]
    return _sha256_of_files(named) | _scene_hashes(scene, env_name)


def _scene_hashes(scene: str, env_name: str) -> dict[str, str]:
    """SHA-256 of a planar scene's YAML and image files, or of a field scene's solids."""
    path = Path(scene)
    if path.suffix not in (".yaml", ".yml"):
        return {}
    if env_name == "planar":
        return _sha256_of_files([path, *path.parent.glob("*.p[gn][mg]")])
    sha = hashlib.sha256(path.read_bytes())
    for solid in read_user_scene(path).solids:
        sha.update(solid.vertices.tobytes() + solid.faces.tobytes())
    return {scene: sha.hexdigest()}


def _sha256_of_files(paths: Sequence[Path]) -> dict[str, str]:
    return {
        str(path): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths if path.is_file()
    }


@lru_cache(maxsize=4)
def _env(arguments: str) -> MappingEnv[Any]:
    values = json.loads(arguments)
    return make_env(values["env_name"], values["env_kwargs"], values["settings"])


@lru_cache(maxsize=16)
def _policy(spec: str, arguments: str) -> Policy:
    policy = make_policy(spec)
    warm_up(_env(arguments), policy)
    return policy


def run_job(job: Job) -> Result:
    """Play the episode of a job; environments and policies are reused by later jobs."""
    env_values = {name: value for name, value in job.items() if name not in POLICY_KEYS}
    arguments = json.dumps(env_values, sort_keys=True)
    return asdict(run_episode(_env(arguments), _policy(job["policy"], arguments), job["seed"]))


def _is_episode(result: Any) -> bool:
    """Whether a stored result has the fields of an episode of this version."""
    try:
        episode_from_dict(result)
    except (TypeError, KeyError):
        return False
    return True


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

    An interrupted comparison can be resumed. Results do not depend on the number of workers, except
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
        `PlanarSettings` or `FieldSettings`.
    env_name : {"planar", "field"}
    backend : {"processes", "ray"}
        Kind of the workers; see `run_jobs`.
    """
    # bad specs and arguments are rejected before any episode is played
    policy_objects = [make_policy(policy) for policy in policies]
    with closing(get_env_spec(env_name).make(**env_kwargs, settings=settings)) as trial_env:
        warm_up(trial_env, *policy_objects)
    jobs = [
        make_job(policy, seed, env_kwargs, settings, env_name)
        for policy in policies
        for seed in seeds
    ]
    results = iter(run_jobs(run_job, jobs, results_dir, workers, progress, _is_episode, backend))
    return {
        policy: Evaluation(tuple(episode_from_dict(next(results)) for _ in seeds))
        for policy in policies
    }


def summarize(evaluations: dict[str, Evaluation], reference: str | None) -> dict[str, Any]:
    """Scores of each policy with 95 % intervals, and its comparison with a reference policy.

    For every score: the mean, and the interquartile mean with its stratified bootstrap interval
    (the worlds of a policy are one stratum).
    The comparison is over the paired worlds: the probability of improvement over the reference, and
    the mean difference in the area under the coverage curve.

    Parameters
    ----------
    evaluations : dict
        By policy.
    reference : str, optional
        Name of the reference policy.
    """
    summary: dict[str, Any] = {}
    for name, evaluation in evaluations.items():
        rng = np.random.default_rng(BOOTSTRAP_SEED)
        table = evaluation.table
        entry: dict[str, Any] = {"episodes": len(evaluation.episodes)}
        if len(evaluation.episodes) > 1:
            for score in (score for score in SUMMARY_SCORES if score in table):
                entry[score] = {
                    "mean": bootstrap_mean(table[score], rng).as_dict(),
                    "interquartile_mean": bootstrap_interquartile_mean(
                        [table[score]], rng
                    ).as_dict(),
                }
            if reference is not None and name != reference:
                ours, theirs = table["coverage_auc"], evaluations[reference].table["coverage_auc"]
                entry["comparison"] = {
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
