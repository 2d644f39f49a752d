"""Playing a policy for a submission: episodes are jobs, so that an interrupted one is resumed."""

from __future__ import annotations

import json
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, TypedDict

import numpy as np

from coopmap_env import families
from coopmap_env.core.caches import thread_cache
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
from coopmap_env.families import N_WORLDS
from coopmap_env.families.worlds import definition_hash
from coopmap_env.studies.leaderboard.private_worlds import Salt, world_seed
from coopmap_env.studies.leaderboard.replay import map_hash, scores_of
from coopmap_env.studies.leaderboard.reported import machine, model_size, versions
from coopmap_env.studies.leaderboard.submission import (
    FEWEST_WORLDS,
    FORMAT,
    SPLIT,
    EpisodeRecord,
    Options,
    Submission,
    make_env,
    write_submission,
)


class _Played(TypedDict):
    """Result of a job."""

    record: EpisodeRecord
    decision_ms: float
    model: dict[str, int | None]


def check_n_worlds(n_worlds: int, is_private: bool) -> None:
    """ValueError unless a submission can have so many worlds."""
    most = N_WORLDS[SPLIT]
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

    Parameters
    ----------
    family : str
    policy : str
        Spec; see `make_policy`.
    n_worlds : int
    options : Options
    path : Path
        Of the file. Finished episodes are kept in the folder of the same name that ends in
        ``.episodes``: the same call resumes an interrupted one.
    workers : int
        Episodes at a time; only the times of decisions depend on it.
    salt : Salt, optional
        Of private worlds.
    progress : bool
        Show a bar (extra ``cli``).

    Raises
    ------
    ValueError
        If the family, the policy, an option or the number of worlds is not accepted.
    WorldMismatchError
        If a world is not the frozen one.
    """
    check_n_worlds(n_worlds, salt is not None)
    chosen = families.get(family)
    made = make_policy(policy)
    with closing(make_env(family, options)) as env:
        warm_up(env, made)  # what does not fit is refused before any episode is played
    fingerprint, files = str(getattr(made, "fingerprint", "")), file_hashes(policy, "", "")
    jobs: list[Job] = [
        {
            "version": __version__,
            "family": family,
            "definition": definition_hash(chosen),
            "options": dict(options),
            "policy": policy,
            "fingerprint": fingerprint,
            "files": files,
            "world": world,
            "seed": world_seed(salt, family, world),
            "is_private": salt is not None,
        }
        for world in range(n_worlds)
    ]
    folder, is_valid = (
        path.with_name(f"{path.stem}.episodes"),
        partial(has_type, annotation=_Played),
    )
    played = run_jobs(play_job, jobs, folder, workers, progress, is_valid)
    submission: Submission = {
        "format": FORMAT,
        "family": family,
        "definition": definition_hash(chosen),
        "split": SPLIT,
        "private": None if salt is None else salt.digest,
        "policy": policy,
        "fingerprint": fingerprint,
        "files": files,
        "options": options,
        "n_worlds": n_worlds,
        "reported": {
            "decision_ms": float(np.mean([one["decision_ms"] for one in played])),
            "model_bytes": played[0]["model"]["model_bytes"],
            "n_parameters": played[0]["model"]["n_parameters"],
            "machine": machine(),
            "versions": versions(),
        },
        "episodes": [one["record"] for one in played],
    }
    write_submission(path, submission)
    return submission


def play_job(job: Job) -> Result:
    """Play the episode of a job; later jobs of the thread reuse environment and policy."""
    key = env_key(job)
    env = remembered_env(key)
    policy = _policy(job["policy"], key)
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
    return {
        "record": record,
        "decision_ms": episode.planning_time_ms,
        "model": model_size(policy),
    }


def _as_json(action: Any) -> int | list[float]:
    """An action that the environment has accepted; floats are read back to the same bits."""
    values = np.asarray(action)
    return int(values) if values.ndim == 0 else [float(value) for value in values]


def env_key(job: Job) -> str:
    """What decides the environment of a job."""
    return json.dumps({name: job[name] for name in ("family", "options")}, sort_keys=True)


@thread_cache(maxsize=4)
def remembered_env(key: str) -> MappingEnv[Any]:
    """The environment of a family and options, as JSON."""
    values = json.loads(key)
    return make_env(values["family"], values["options"])


@thread_cache(maxsize=4)
def _policy(spec: str, key: str) -> Policy:
    policy = make_policy(spec)
    warm_up(remembered_env(key), policy)
    return policy
