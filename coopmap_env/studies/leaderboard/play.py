"""Playing a policy for a submission: episodes are jobs, so that an interrupted one is resumed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from coopmap_env import families
from coopmap_env.core.caches import json_cache
from coopmap_env.core.files import FileError
from coopmap_env.core.json_types import has_type
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation import (
    EpisodeRecorder,
    Job,
    Policy,
    Result,
    file_hashes,
    make_policy,
    rollout,
    run_jobs,
)
from coopmap_env.evaluation.rollout import warm_up
from coopmap_env.families import Family
from coopmap_env.families.worlds import definition_hash, n_frozen
from coopmap_env.studies.leaderboard.private_worlds import Salt, world_seed
from coopmap_env.studies.leaderboard.replay import map_hash, scores_of
from coopmap_env.studies.leaderboard.reported import machine, model_size, own_versions
from coopmap_env.studies.leaderboard.submission import (
    FEWEST_WORLDS,
    FORMAT,
    SPLIT,
    EpisodeRecord,
    Options,
    Submission,
    check_head,
    make_env,
    write_submission,
)


class _Played(TypedDict):
    """Result of a job."""

    record: EpisodeRecord
    decision_ms: float


def check_n_worlds(family: Family, n_worlds: int, is_private: bool) -> None:
    """ValueError unless a submission to a family can have so many worlds."""
    most = n_frozen(family, SPLIT)
    if n_worlds < FEWEST_WORLDS or (n_worlds > most and not is_private):
        limit = f"from {FEWEST_WORLDS} to {most}, as many as are frozen"
        raise ValueError(
            f"episodes must be {f'at least {FEWEST_WORLDS}' if is_private else limit}, "
            f"got {n_worlds}"
        )


def submit(
    family: str,
    policy: str,
    n_worlds: int,
    options: Options,
    path: Path,
    workers: int = 1,
    salt: Salt | None = None,
    progress: bool = True,
) -> Submission:
    """Play a policy on the first test worlds of a family, and write the submission.

    What cannot be written is refused before the first episode: all but the episodes is checked as
    it will be read (`check_head`).

    Parameters
    ----------
    family : str
    policy : str
        Spec; see `make_policy`.
    n_worlds : int
    options : Options
    path : Path
        Of the file; see `write_submission`. Finished episodes are kept in the folder of the same
        name that ends in ``.episodes``: the same call resumes an interrupted one.
    workers : int
        Episodes at a time; only the times of decisions depend on it.
    salt : Salt, optional
        Of private worlds.
    progress : bool
        Show a bar.

    Raises
    ------
    ValueError
        If the family, the policy, an option or the number of worlds is not accepted, or something
        that the submission would state.
    FileError
        If there is a folder in place of the file.
    WorldMismatchError
        If a world is not the frozen one.
    """
    chosen, name = families.get(family), Path(path.name.removesuffix(".gz"))
    folder = path.with_name(f"{name.stem}.episodes")
    check_n_worlds(chosen, n_worlds, salt is not None)
    if path.is_dir() or path == folder:
        raise FileError(f"{path} is a folder, or the one of the episodes: name a file")
    made = make_policy(policy)
    with closing(make_env(family, options)) as env:
        warm_up(env, made)
    size = model_size(made)
    submission: Submission = {
        "format": FORMAT,
        "family": family,
        "definition": definition_hash(chosen),
        "split": SPLIT,
        "private": None if salt is None else salt.digest,
        "policy": policy,
        "fingerprint": str(getattr(made, "fingerprint", "")),
        "files": file_hashes(policy, "", ""),
        "options": options,
        "n_worlds": n_worlds,
        "reported": {
            "decision_ms": 0.0,
            "model_bytes": size["model_bytes"],
            "n_parameters": size["n_parameters"],
            "machine": machine(),
            "versions": own_versions(),
        },
        "episodes": [],
    }
    check_head(submission)
    jobs: list[Job] = [
        {
            "version": __version__,
            "family": family,
            "definition": submission["definition"],
            "options": dict(options),
            "policy": policy,
            "fingerprint": submission["fingerprint"],
            "files": submission["files"],
            "world": world,
            "seed": world_seed(salt, family, world),
            "is_private": salt is not None,
        }
        for world in range(n_worlds)
    ]
    is_valid = partial(has_type, annotation=_Played)
    played = run_jobs(play_job, jobs, folder, workers, progress, is_valid)
    submission["reported"]["decision_ms"] = float(np.mean([one["decision_ms"] for one in played]))
    submission["episodes"] = [one["record"] for one in played]
    write_submission(path, submission)
    return submission


def play_job(job: Job) -> Result:
    """Play the episode of a job; later jobs of the thread reuse environment and policy."""
    env = remembered_env(job["family"], job["options"])
    policy = _policy(job["policy"], job["family"], job["options"])
    steps = rollout(env, policy, job["seed"])
    if not job["is_private"]:
        families.check_world(families.get(job["family"]), env, job["seed"])
    found = families.world_hash(env)
    recorder, actions = EpisodeRecorder(env, job["seed"]), []
    for step in steps:
        recorder.add(step)
        actions.append([_as_json(step.actions[agent]) for agent in env.possible_agents])
    episode = recorder.episode()
    record: EpisodeRecord = {
        "world": job["world"],
        "world_hash": found,
        "actions": actions,
        "scores": scores_of(episode),
        "map_hash": map_hash(env.belief().map),
    }
    return {"record": record, "decision_ms": episode.planning_time_ms}


def _as_json(action: Any) -> int | list[float]:
    """An action that the environment has accepted; floats are read back to the same bits."""
    values = np.asarray(action)
    return int(values) if values.ndim == 0 else [float(value) for value in values]


remembered_env: Callable[[str, Options], MappingEnv[Any]] = json_cache(maxsize=4)(make_env)
"""`make_env`; later jobs of the thread get the same environment."""


@json_cache(maxsize=4)
def _policy(spec: str, family: str, options: Options) -> Policy:
    policy = make_policy(spec)
    warm_up(remembered_env(family, options), policy)
    return policy
