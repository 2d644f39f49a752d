"""How long policies take to decide: CPU time, on which other processes have little influence."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from coopmap_env import families
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation import Job, Policy, Result, make_policy, rollout, run_jobs
from coopmap_env.evaluation.rollout import warm_up
from coopmap_env.families import Family
from coopmap_env.studies.clairvoyant import CLAIRVOYANT
from coopmap_env.studies.families.play import PLAYED_POLICIES


def time_policies(
    family: Family, split: str, seed: int, names: Sequence[str], folder: Path, workers: int = 1
) -> dict[str, float]:
    """CPU time of a decision of one robot in one world, milliseconds, by name; resumable.

    Parameters
    ----------
    family : Family
    split : {"train", "validation", "test"}
    seed : int
        Of the world.
    names : sequence of str
        Keys of `PLAYED_POLICIES` and `CLAIRVOYANT`.
    folder : Path
        Keeps the times.
    workers : int
        Policies at a time.
    """
    jobs: list[Job] = [
        {
            "version": __version__,
            "family": family.name,
            "definition": family.definition,
            "split": split,
            "policy": name,
            "seed": seed,
        }
        for name in names
    ]
    results = run_jobs(run_timing_job, jobs, folder, workers, is_valid=_is_time)
    return {name: result["decision_ms"] for name, result in zip(names, results, strict=True)}


def run_timing_job(job: Job) -> Result:
    """Time the decisions of a policy."""
    name, entry = job["policy"], PLAYED_POLICIES.get(job["policy"])
    arguments = {} if entry is None else entry.env_kwargs
    with closing(families.make(job["family"], job["split"], **arguments)) as env:
        policy = CLAIRVOYANT[name](env) if entry is None else make_policy(entry.spec)
        return {"decision_ms": decision_ms(env, policy, job["seed"])}


def decision_ms(env: MappingEnv[Any], policy: Policy, seed: int) -> float:
    """Mean CPU time of a decision of one robot in the world of a seed, milliseconds.

    Kernels are compiled and weights are loaded before.
    """
    warm_up(env, policy)
    steps = rollout(env, policy, seed, clock=time.process_time)
    seconds = [step.decision_s / len(step.actions) for step in steps]
    return 1e3 * sum(seconds) / len(seconds)


def _is_time(result: Any) -> bool:
    return isinstance(result, dict) and isinstance(result.get("decision_ms"), float)
