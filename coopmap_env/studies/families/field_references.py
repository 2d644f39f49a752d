"""References in the worlds of field families: clairvoyant policies, and bounds of the surface.

They are played together, a world at a time, as what poses of the set truly view is needed by all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env import families
from coopmap_env.core.caches import json_cache
from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldEnv
from coopmap_env.evaluation import (
    Evaluation,
    Job,
    Result,
    episode_from_dict,
    is_episode,
    make_surface_evaluator,
    policy_rng,
    run_episode,
    run_jobs,
)
from coopmap_env.evaluation.bounds import kept_bound
from coopmap_env.families import Family
from coopmap_env.studies.clairvoyant import (
    N_DRAWN,
    ClairvoyantFieldGreedy,
    ClairvoyantFieldLookAhead,
    surface_views,
)

FIELD_CLAIRVOYANT = {
    "clairvoyant, greedy": ClairvoyantFieldGreedy,
    "clairvoyant, look-ahead": ClairvoyantFieldLookAhead,
}
"""References that know the field world."""
COUNTS = ("chosen", "most", "n_samples")


class SurfaceBounds(NamedTuple):
    """Fractions of the visible surface of some worlds."""

    most: NDArray[np.float64]
    """What scans without noise cover at most, from poses of the set (n_worlds,)."""
    chosen: NDArray[np.float64]
    """What some of these poses cover together (n_worlds,)."""
    n_scans: int
    """Of each robot."""


def play_field_references(
    family: Family,
    split: str,
    seeds: Sequence[int],
    folder: Path,
    workers: int,
    names: Sequence[str],
) -> tuple[dict[str, Evaluation], SurfaceBounds]:
    """Play clairvoyant policies and bound the covered surface; resumable.

    The bound is of the poses among which these policies choose (`true_pose_sets`), of as many scans
    as fit into an episode, and of the samples of the surface by which maps are scored. All poses
    count as possible from the first scan on, and motions take no time.

    Parameters
    ----------
    family : Family
    split : {"train", "validation", "test"}
    seeds : sequence of int
    folder : Path
        Keeps the results, and a file with the certificates of each world.
    workers : int
        Worlds at a time.
    names : sequence of str
        Keys of `FIELD_CLAIRVOYANT`.
    """
    folder.mkdir(parents=True, exist_ok=True)
    jobs: list[Job] = [
        {
            "version": __version__,
            "family": family.name,
            "definition": family.definition,
            "split": split,
            "policies": list(names),
            "n_drawn": N_DRAWN,
            "seed": seed,
        }
        for seed in seeds
    ]
    results = run_jobs(
        partial(run_references, folder), jobs, folder / "jobs", workers, is_valid=_is_result
    )
    evaluations = {
        name: Evaluation(tuple(episode_from_dict(own["episodes"][name]) for own in results))
        for name in names
    }
    chosen, most = (
        np.array([own[name] / own["n_samples"] for own in results]) for name in COUNTS[:2]
    )
    return evaluations, SurfaceBounds(most, chosen, results[0]["n_scans"])


def run_references(folder: Path, job: Job) -> Result:
    """Play the references in a world, and bound it or check the bound that was found before."""
    env, seed = _env(job["family"], job["split"]), job["seed"]
    env.reset(seed=seed)
    evaluator = make_surface_evaluator(env, seed)
    views = surface_views(env, policy_rng(seed), job["n_drawn"], evaluator)
    bound_file = folder / f"{views.digest[:16]}.npz"
    found = kept_bound(bound_file, views, views.n_scans)
    episodes = {}
    for name in job["policies"]:
        policy = FIELD_CLAIRVOYANT[name](env, lambda rng: views)
        episodes[name] = asdict(run_episode(env, policy, seed, lambda seed: evaluator))
    return {
        "episodes": episodes,
        "most": int(found.bounds[-1]),
        "chosen": int(found.choice_shown[-1]),
        "n_samples": len(views.known),
        "n_scans": views.n_scans,
    }


@json_cache(maxsize=2)
def _env(name: str, split: str) -> FieldEnv:
    env = families.make(name, split, report_shown=True)
    assert isinstance(env, FieldEnv)
    return env


def _is_result(result: Any) -> bool:
    """Whether a stored result has episodes, and counts of samples that fit together."""
    try:
        chosen, most, n_samples = (result[name] for name in COUNTS)
        is_possible = 0 <= chosen <= most <= n_samples and result["n_scans"] >= 1
        return is_possible and all(map(is_episode, result["episodes"].values()))
    except (TypeError, KeyError, AttributeError):
        return False
