"""The localization study: target registration (Section 2.2) and motion correction (Section 2.5).

Two robots on worksites of the test split are moved by the rating function. In the first part they
search for the target from base poses with any heading. In the second part they are located, and map
with each mode of motion correction.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.settings import PositiveInt, Settings, settings_to_dict
from coopmap_env.core.version import __version__
from coopmap_env.envs.field import FieldSettings
from coopmap_env.evaluation import (
    BOOTSTRAP_SEED,
    Evaluation,
    Job,
    Result,
    episode_from_dict,
    run_jobs,
)
from coopmap_env.studies.localization.episodes import run_localization_job
from coopmap_env.studies.localization.estimator_comparison import compare_pose_estimators
from coopmap_env.studies.localization.stored_results import is_correction_result, is_search_result

POLICY = "rating_function:search=100"
CORRECTION_MODES = ("encoders", "kinematic", "fiducials", "exact")
"""Of `FieldEnv`: encoders alone, with the predicted deflection of the suspension, corrected by
fiducials, and the true poses as an upper bound."""
SCANS_EACH = 16
"""Of each robot in the second part: 32 scans of the team."""
SEARCH_SCANS = 10
"""Of each robot in the first part, at most."""
SCENE = "worksite"


@dataclass(frozen=True)
class LocalizationSize(Settings):
    """Numbers of worlds and draws."""

    search_worlds: PositiveInt
    map_worlds: PositiveInt
    n_draws: PositiveInt
    """Random draws of the comparison of pose estimators."""


FULL = LocalizationSize(100, 100, 300)
QUICK = LocalizationSize(8, 3, 50)


@dataclass(frozen=True)
class LocalizationStudy:
    """Results of the study."""

    size: LocalizationSize
    searches: list[Result]
    """One for each world; see `run_search_episode`."""
    runs: dict[str, list[Result]]
    """By correction mode, one for each world; see `run_correction_episode`."""
    pose_estimators: dict[str, Any]
    """Without and with outliers; see `compare_pose_estimators`."""

    @property
    def evaluations(self) -> dict[str, Evaluation]:
        """Map quality by correction mode."""
        return {
            name: Evaluation(tuple(episode_from_dict(run["episode"]) for run in runs))
            for name, runs in self.runs.items()
        }


def run_localization_study(
    store: Path, size: LocalizationSize, workers: int, log: Callable[[str], None]
) -> LocalizationStudy:
    """Run the study.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not run again.
    size : LocalizationSize
    workers : int
        Processes; the results do not depend on it, times apart.
    log : callable
        Receives a line of progress.
    """
    log(f"searching for the target: {size.search_worlds} test worksites, two robots")
    jobs = [_make_job("search", seed, SEARCH_SCANS) for seed in range(size.search_worlds)]
    searches = run_jobs(run_localization_job, jobs, store, workers, is_valid=is_search_result)
    log(
        f"mapping with {', '.join(CORRECTION_MODES)} camera poses: {size.map_worlds} test worksites"
    )
    jobs = [
        _make_job(
            "correction", seed, SCANS_EACH, initialization="located", motion_correction=setting
        )
        for setting in CORRECTION_MODES
        for seed in range(size.map_worlds)
    ]
    is_valid = partial(is_correction_result, n_scans=SCANS_EACH)
    results = iter(run_jobs(run_localization_job, jobs, store, workers, is_valid=is_valid))
    runs = {name: [next(results) for _ in range(size.map_worlds)] for name in CORRECTION_MODES}
    log("comparison of pose estimators")
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    pose_estimators = {
        "without outliers": compare_pose_estimators(rng, size.n_draws, 0.0),
        "10 % outliers": compare_pose_estimators(rng, size.n_draws, 0.1),
    }
    return LocalizationStudy(size, searches, runs, pose_estimators)


def _make_job(kind: str, seed: int, scans: int, **environment: str) -> Job:
    return {
        "version": __version__,
        "kind": kind,
        "seed": seed,
        "split": "test",
        "max_scans": scans,
        "scene": SCENE,
        "policy": POLICY,
        "settings": settings_to_dict(FieldSettings()),
        **environment,
    }
