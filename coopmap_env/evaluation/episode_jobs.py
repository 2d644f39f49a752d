"""Episodes as jobs: JSON values that determine the result, played in any process."""

from __future__ import annotations

from dataclasses import asdict
from functools import lru_cache, partial
from typing import Any

from coopmap_env.core.caches import json_cache
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation.env_specs import make_env
from coopmap_env.evaluation.episode import EvaluatorFor, make_surface_evaluator, run_episode
from coopmap_env.evaluation.hashes import file_hashes
from coopmap_env.evaluation.jobs import Job, Result
from coopmap_env.evaluation.policy import Policy, make_policy
from coopmap_env.evaluation.rollout import warm_up

POLICY_KEYS = ("policy", "fingerprint", "seed")
"""Entries of a job that its environment does not depend on."""
N_EVALUATORS = 4
"""Worlds of an environment whose surface evaluators are remembered: one takes eight megabytes, and
a comparison plays all policies on a world before the next."""


def make_job(
    policy: str, seed: int, env_kwargs: dict[str, Any], settings: Any, env_name: str = "planar"
) -> Job:
    """One episode as JSON values. They determine its result: equal jobs have equal results.

    Files that are named by the policy's options, by the scene (its YAML file, images, meshes and
    URDFs) or by the mount (its URDF and meshes) enter by the hash of their content. So does the
    `fingerprint` of a policy that has one: learned weights can change under the same name.

    Parameters
    ----------
    policy : str
        Spec, see `make_policy`.
    seed : int
    env_kwargs : dict
        Arguments of the environment as JSON values, without the settings.
    settings : PlanarSettings or FieldSettings
        Those of the environment, also where they are the defaults, which may change.
    env_name : {"planar", "field"}
    """
    return {
        "version": __version__,
        "files": file_hashes(
            policy,
            str(env_kwargs.get("scene", "")),
            env_name,
            mount if isinstance(mount := env_kwargs.get("mount"), dict) else None,
        ),
        "policy": policy,
        "fingerprint": _fingerprint(policy),
        "seed": seed,
        "env_name": env_name,
        "env_kwargs": env_kwargs,
        "settings": settings_to_dict(settings),
    }


@lru_cache(maxsize=64)
def _fingerprint(policy: str) -> str:
    return str(getattr(make_policy(policy), "fingerprint", ""))


@json_cache(maxsize=4)
def _env(values: dict[str, Any]) -> tuple[MappingEnv[Any], EvaluatorFor]:
    """An environment, and the surface evaluators of its worlds, which all policies share.

    An evaluator refers to its environment: they are remembered together.
    """
    arguments_and_scores = {**values["env_kwargs"], "report_shown": True}
    env = make_env(values["env_name"], arguments_and_scores, values["settings"])
    return env, lru_cache(maxsize=N_EVALUATORS)(partial(make_surface_evaluator, env))


@json_cache(maxsize=128)
def _policy(spec: str, env_values: dict[str, Any]) -> Policy:
    policy = make_policy(spec)
    warm_up(_env(env_values)[0], policy)
    return policy


def run_job(job: Job) -> Result:
    """Play the episode of a job.

    Later jobs of the thread reuse environment, policy and evaluator of the surface.
    """
    env_values = {name: value for name, value in job.items() if name not in POLICY_KEYS}
    policy = _policy(job["policy"], env_values)
    env, evaluator_for = _env(env_values)
    return asdict(run_episode(env, policy, job["seed"], evaluator_for))
