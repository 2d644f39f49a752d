"""Episodes of clairvoyant references as jobs, on the worlds of any planar environment."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

from coopmap_env.core.caches import json_cache
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation import (
    Evaluation,
    Job,
    Result,
    episode_from_dict,
    file_hashes,
    get_env_spec,
    is_episode,
    make_env,
    run_episode,
    run_jobs,
)
from coopmap_env.studies.clairvoyant.policy import (
    ClairvoyantGreedy,
    ClairvoyantLookAhead,
    LookAhead,
)

CLAIRVOYANT: dict[str, Callable[[PlanarEnv], ClairvoyantGreedy]] = {
    "clairvoyant, greedy": ClairvoyantGreedy,
    "clairvoyant, look-ahead": partial(ClairvoyantLookAhead, settings=LookAhead(n_tried=4)),
}
"""References that know the planar world, by their names in tables. Plans of the second one begin
with few poses, as its default takes a minute of CPU time for an episode."""


def play_clairvoyant(
    name: str,
    seeds: Sequence[int],
    env_kwargs: dict[str, Any],
    results_dir: Path,
    settings: Any = None,
    workers: int = 1,
    progress: bool = True,
) -> Evaluation:
    """Play a reference as `coopmap_env.evaluation.compare` plays policies; resumable.

    Parameters
    ----------
    name : str
        One of `CLAIRVOYANT`.
    seeds, env_kwargs, results_dir, settings, workers, progress
        As of `compare`.
    """
    with closing(get_env_spec("planar").make(**env_kwargs, settings=settings)) as env:
        values = settings_to_dict(env.settings)
    shared = {
        "version": __version__,
        "files": file_hashes("", str(env_kwargs.get("scene", "")), "planar"),
        "reference": name,
        "env_kwargs": env_kwargs,
        "settings": values,
    }
    jobs: list[Job] = [{**shared, "seed": seed} for seed in seeds]
    results = run_jobs(
        run_clairvoyant_job, jobs, results_dir, workers, progress, is_valid=is_episode
    )
    return Evaluation(tuple(map(episode_from_dict, results)))


def run_clairvoyant_job(job: Job) -> Result:
    """Play an episode of a reference."""
    env = _env(job["env_kwargs"], job["settings"])
    return asdict(run_episode(env, CLAIRVOYANT[job["reference"]](env), job["seed"]))


@json_cache(maxsize=2)
def _env(env_kwargs: dict[str, Any], settings: dict[str, Any]) -> PlanarEnv:
    env = make_env("planar", {**env_kwargs, "report_shown": True}, settings)
    assert isinstance(env, PlanarEnv)
    return env
