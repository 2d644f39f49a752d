"""Bounds of many worlds as jobs, whose certificates are kept."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from contextlib import closing
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import json_cache
from coopmap_env.core.settings import settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs import MappingEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.evaluation.bounds.efficiency import scans_in_time
from coopmap_env.evaluation.bounds.planar_views import PlanarViews
from coopmap_env.evaluation.bounds.stored import kept_bound
from coopmap_env.evaluation.env_specs import get_env_spec, make_env
from coopmap_env.evaluation.hashes import file_hashes
from coopmap_env.evaluation.jobs import Job, Result, run_jobs


class WorldBound(NamedTuple):
    """How many cells can be shown in a world, before the first scan and after each (n + 1,)."""

    bounds: NDArray[np.int64]
    """At most."""
    choice_shown: NDArray[np.int64]
    """By the best choice of views that is known; see `ShownBound`."""
    cpu_seconds: float
    """Of the search; nan if the bound was read from a file."""

    @property
    def gap(self) -> float:
        """See `ShownBound.gap`."""
        return float(self.bounds[-1] / self.choice_shown[-1] - 1.0)


def bound_worlds(
    seeds: Sequence[int],
    env_kwargs: dict[str, Any],
    folder: Path,
    settings: Any = None,
    workers: int = 1,
    progress: bool = True,
    env_name: str = "planar",
) -> list[WorldBound]:
    """Bounds of what can be shown in the worlds of some seeds.

    Parameters
    ----------
    seeds : sequence of int
    env_kwargs, settings, env_name
        Of the environment, as of `coopmap_env.evaluation.compare`.
    folder : Path
        Keeps the results, and a file with the certificates of each world (`load_bound`), named by
        the hash of its views. Where the result is missing and the file is there, the file is
        checked instead of a new search.
    workers : int
        Worlds at a time.

    Returns
    -------
    list of WorldBound
        Of as many scans as an episode can have.

    Raises
    ------
    ValueError
        If the environment is not planar, or is not accepted.
    BoundFileError
        If a file in the folder is broken.
    """
    with closing(get_env_spec(env_name).make(**env_kwargs, settings=settings)) as env:
        if not isinstance(env, PlanarEnv):
            raise ValueError(f"what can be shown is bounded in planar worlds only, not in {env}")
        values = settings_to_dict(env.settings)
    folder.mkdir(parents=True, exist_ok=True)
    files = file_hashes("", str(env_kwargs.get("scene", "")), env_name)
    jobs: list[Job] = [
        {
            "version": __version__,
            "files": files,
            "env_name": env_name,
            "env_kwargs": env_kwargs,
            "settings": values,
            "seed": seed,
        }
        for seed in seeds
    ]
    results = run_jobs(
        partial(run_bound_job, folder), jobs, folder / "jobs", workers, progress, _is_bound
    )
    return [
        WorldBound(
            np.array(result["bounds"], dtype=np.int64),
            np.array(result["choice_shown"], dtype=np.int64),
            math.nan if result["cpu_seconds"] is None else result["cpu_seconds"],
        )
        for result in results
    ]


def run_bound_job(folder: Path, job: Job) -> Result:
    """Bound what can be shown in a world, or check the bound that was found before."""
    env = _env(job["env_name"], job["env_kwargs"], job["settings"])
    env.reset(seed=job["seed"])
    assert isinstance(env, PlanarEnv)
    n_scans = scans_in_time(env.max_scans, env.max_time, env.settings.scan_time)
    views = PlanarViews.from_env(env, n_scans)
    path = folder / f"{views.digest[:16]}.npz"
    is_searched, start = not path.exists(), time.process_time()
    found = kept_bound(path, views, n_scans)
    return {
        "bounds": found.bounds.tolist(),
        "choice_shown": found.choice_shown.tolist(),
        "cpu_seconds": time.process_time() - start if is_searched else None,
    }


_env: Callable[..., MappingEnv[Any]] = json_cache(maxsize=2)(make_env)


def _is_bound(result: Any) -> bool:
    """Whether a stored result has bounds that do not fall, and what a choice shows."""
    try:
        bounds, shown = (np.array(result[n], dtype=np.int64) for n in ("bounds", "choice_shown"))
        seconds = result["cpu_seconds"]
    except (TypeError, KeyError, ValueError, OverflowError):
        return False
    has_curves = bounds.ndim == 1 and len(bounds) > 1 and shown.shape == bounds.shape
    is_time = seconds is None or (isinstance(seconds, float) and seconds >= 0)
    return has_curves and is_time and bool((np.diff(bounds) >= 0).all())
