"""Recording a policy on many worlds: episodes are jobs, so that an interrupted one is resumed."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Sequence
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, TypedDict

from gymnasium.envs.registration import EnvSpec

from coopmap_env.core.caches import json_cache
from coopmap_env.core.files import (
    FileError,
    atomic_path,
    brief,
    read_bytes,
    remove_temporary_files,
    write_atomically,
)
from coopmap_env.core.json_types import has_type
from coopmap_env.core.locks import folder_lock
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation.env_specs import get_env_spec, make_env, make_team_env
from coopmap_env.evaluation.episode_jobs import POLICY_KEYS, make_job
from coopmap_env.evaluation.jobs import Job, Result, job_key, run_jobs
from coopmap_env.evaluation.offline.dataset import (
    DATA_FILE,
    DATA_FOLDER,
    METADATA_FILE,
    Recipe,
    RecordedDataset,
)
from coopmap_env.evaluation.offline.episode import record_episode
from coopmap_env.evaluation.offline.hdf5_files import open_hdf5, write_episode
from coopmap_env.evaluation.offline.minari_spaces import space_to_json
from coopmap_env.evaluation.policy import Policy, make_policy
from coopmap_env.evaluation.rollout import warm_up

FORMAT = 1
"""Of the episodes' files and of our part of the metadata."""
MINARI_VERSION = "0.5.4"
"""The version of Minari whose format is written: the first that has ``jpeg_encoding``."""
LIBRARIES = ("numpy", "scipy", "numba", "gymnasium", "h5py")
EPISODES_FOLDER = "episodes"
GROUP = "episode"
"""Of the episode, in its own file."""
_DATASET_ID = re.compile(r"([-_\w]+/)*[-_\w]+-v\d+", re.ASCII)


class _Written(TypedDict):
    """Result of a job."""

    file: str
    sha256: str
    n_steps: int


def default_dataset_id(policy: str, env_name: str) -> str:
    """The dataset's name for Minari, such as ``coopmap/planar/rating_function-search-100-v0``.

    Parameters
    ----------
    policy : str
        Spec; see `make_policy`.
    env_name : str
        Of the environment, or of its family.
    """
    return f"coopmap/{env_name}/{re.sub(r'[^A-Za-z0-9_]+', '-', policy).strip('-')}-v0"


def record_dataset(
    policy: str,
    seeds: Sequence[int],
    env_kwargs: dict[str, Any],
    folder: Path,
    settings: Any = None,
    env_name: str = "planar",
    dataset_id: str | None = None,
    workers: int = 1,
    progress: bool = True,
) -> RecordedDataset:
    """Play a policy on the worlds of some seeds and write all that its team saw, did and got.

    The arrays depend on the arguments and versions alone, not on `workers`.

    Parameters
    ----------
    policy : str
        Spec; see `make_policy`.
    seeds : sequence of int
        Of the worlds, in their order.
    env_kwargs : dict
        Arguments of the environment as JSON values, without the settings.
    folder : Path
        Of the dataset. Finished episodes are kept in its folder ``episodes``, which can be removed
        afterwards: the same call resumes an interrupted one.
    settings : PlanarSettings or FieldSettings, optional
    env_name : {"planar", "field"}
    dataset_id : str, optional
        Name for Minari, ``NAMESPACE/.../NAME-vN``; see `default_dataset_id`.
    workers : int
        Episodes at a time.
    progress : bool
        Show a bar.

    Raises
    ------
    ValueError
        If an argument is not accepted.
    ImportError
        If h5py is not installed (extra ``record``), or an extra that the environment needs.
    OSError
        If another process writes into the folder.
    """
    if not seeds:
        raise ValueError("at least one seed is needed")
    name = dataset_id or default_dataset_id(policy, env_name)
    if not _DATASET_ID.fullmatch(name):
        raise ValueError(
            f"a dataset id is written NAMESPACE/NAME-vN with letters, digits, - and _, as "
            f"coopmap/planar/frontier-v0, got {brief(name)}"
        )
    chosen = get_env_spec(env_name).settings_class() if settings is None else settings
    jobs = [
        {**make_job(policy, seed, env_kwargs, chosen, env_name), "format": FORMAT} for seed in seeds
    ]
    # what does not fit fails before the first episode
    _policy(policy, jobs[0]["fingerprint"], _env_values(jobs[0]))
    episodes = folder / EPISODES_FOLDER
    with folder_lock(folder):
        is_valid = partial(_is_written, episodes)
        record = partial(record_job, episodes)
        written = run_jobs(record, jobs, episodes, workers, progress, is_valid)
        _write_dataset(folder, name, jobs, written)
    return RecordedDataset(folder)


def record_job(folder: Path, job: Job) -> Result:
    """Play the episode of a job and write its file into a folder.

    Later jobs of the thread reuse environment and policy.
    """
    values = _env_values(job)
    policy = _policy(job["policy"], job["fingerprint"], values)
    episode = record_episode(_env(values), policy, job["seed"])
    path = folder / f"{job_key(job)}.hdf5"
    with atomic_path(path) as temporary:
        with open_hdf5(temporary, "w") as file:
            write_episode(file.create_group(GROUP), episode)
        sha256 = hashlib.sha256(read_bytes(temporary)).hexdigest()
    return {"file": path.name, "sha256": sha256, "n_steps": len(episode)}


def _env_values(job: Job) -> dict[str, Any]:
    """What the environment of a job depends on."""
    return {name: value for name, value in job.items() if name not in POLICY_KEYS}


@json_cache(maxsize=2)
def _env(values: dict[str, Any]) -> MappingEnv[Any]:
    return make_env(values["env_name"], values["env_kwargs"], values["settings"])


@json_cache(maxsize=2)
def _policy(spec: str, fingerprint: str, values: dict[str, Any]) -> Policy:
    policy = make_policy(spec)
    warm_up(_env(values), policy)
    return policy


def _is_written(folder: Path, result: Any) -> bool:
    """Whether a result has its file, and that is what was written."""
    if not has_type(result, _Written) or not re.fullmatch(r"[0-9a-f]+\.hdf5", result["file"]):
        return False
    try:
        content = read_bytes(folder / result["file"])
    except FileError:
        return False
    return hashlib.sha256(content).hexdigest() == result["sha256"]


def _write_dataset(folder: Path, name: str, jobs: Sequence[Job], written: Sequence[Result]) -> None:
    """Gather the episodes in one file, then write the metadata: without them it is no dataset."""
    data, metadata = folder / DATA_FOLDER / DATA_FILE, folder / DATA_FOLDER / METADATA_FILE
    data.parent.mkdir(exist_ok=True)
    remove_temporary_files(data.parent)
    metadata.unlink(missing_ok=True)
    with atomic_path(data) as temporary, open_hdf5(temporary, "w") as file:
        for k, result in enumerate(written):
            with open_hdf5(folder / EPISODES_FOLDER / result["file"], "r") as source:
                source.copy(GROUP, file, name=f"episode_{k}")  # packed as it is
            file[f"episode_{k}"].attrs["id"] = k
    n_steps = sum(result["n_steps"] for result in written)
    values = _metadata(name, jobs, n_steps, data.stat().st_size)
    write_atomically(metadata, json.dumps(values, indent=1) + "\n")


def _metadata(name: str, jobs: Sequence[Job], n_steps: int, n_bytes: int) -> dict[str, Any]:
    """Minari's entries, and under "coopmap" all that decides the arrays."""
    common = jobs[0]
    env_name, env_kwargs, settings = (common[key] for key in ("env_name", "env_kwargs", "settings"))
    team = make_team_env(env_name, env_kwargs, settings)
    spec = EnvSpec(
        id=str(team.parallel.metadata["name"]),
        entry_point="coopmap_env.evaluation.env_specs:make_team_env",
        kwargs={"env_name": env_name, "arguments": env_kwargs, "settings": settings},
    )
    recipe: Recipe = {
        "format": FORMAT,
        "versions": {"coopmap": __version__, **{each: version(each) for each in LIBRARIES}},
        "policy": common["policy"],
        "fingerprint": common["fingerprint"],
        "files": common["files"],
        "env_name": env_name,
        "env_kwargs": env_kwargs,
        "settings": settings,
        "seeds": [job["seed"] for job in jobs],
    }
    observation_space, action_space = team.observation_space, team.action_space
    team.close()
    return {
        "dataset_id": name,
        "description": f"Episodes of the policy {common['policy']} in {spec.id}, recorded by "
        "coopmap record. The policies that made them are no part of the file.",
        "algorithm_name": common["policy"],
        "minari_version": MINARI_VERSION,
        "requirements": [f"coopmap=={__version__}"],
        "total_episodes": len(jobs),
        "total_steps": n_steps,
        "dataset_size": round(n_bytes / 1e6, 1),
        "data_format": "hdf5",
        "jpeg_encoding": False,
        "observation_space": space_to_json(observation_space),
        "action_space": space_to_json(action_space),
        "env_spec": spec.to_json(),
        "coopmap": recipe,
    }
