"""The 3-D study: policies on test worksites, a comparison with OctoMap, a real stereo pair.

`run` plays the policies on worlds of the test split. One episode of the rating function is kept for
the picture, the replay and the comparison with OctoMap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.settings import PositiveInt, Settings
from coopmap_env.envs.field import FieldEnv, FieldSettings
from coopmap_env.evaluation import BOOTSTRAP_SEED, Evaluation, Policy, compare, make_policy, rollout
from coopmap_env.evaluation.replay import Replay, record_replay
from coopmap_env.sensing import Scan
from coopmap_env.studies.field import stereo
from coopmap_env.studies.field.octomap_comparison import OctomapComparison, compare_with_octomap

RATING = "rating_function:search=100"
RANDOM = "random"
SCANS_EACH = 16
"""Two robots: 32 scans together, as in Section 3."""
RECORDED_SEED = 0
"""Seed of the episode that is kept for the picture, the replay and OctoMap."""


@dataclass(frozen=True)
class FieldSize(Settings):
    """Number of worlds, and the policies."""

    worlds: PositiveInt
    policies: tuple[str, ...]


FULL = FieldSize(
    20,
    (
        RATING,
        "rating_function:search=300",
        f"{RATING}+coordination=sequential",
        "information_gain",
        "coverage",
        "frontier",
        "raster",
        RANDOM,
    ),
)
QUICK = FieldSize(2, (RATING, RANDOM))


@dataclass(frozen=True)
class FieldStudy:
    """Results of the study."""

    size: FieldSize
    settings: FieldSettings
    evaluations: dict[str, Evaluation]
    octomap: OctomapComparison
    """On the scans of the recorded episode, in the order of their fusion."""
    frame: NDArray[np.uint8]
    """Last picture of the recorded episode (H, W, 3)."""
    replay: Replay
    stereo: stereo.StereoResult


def run_field_study(
    store: Path, size: FieldSize, workers: int, log: Callable[[str], None]
) -> FieldStudy:
    """Run the study.

    Parameters
    ----------
    store : Path
        Folder of finished episodes, which are not run again.
    size : FieldSize
    workers : int
        Processes; the results do not depend on it.
    log : callable
        Receives a line of progress.
    """
    log(f"field environment: {size.worlds} test worksites, {len(size.policies)} policies")
    arguments = {"max_scans": SCANS_EACH, "split": "test"}
    settings = FieldSettings()
    evaluations = compare(
        size.policies, range(size.worlds), arguments, store, settings, workers, env_name="field"
    )
    log("one episode: its replay, and OctoMap on its scans")
    env = FieldEnv(split="test", max_scans=SCANS_EACH, settings=settings, render_mode="rgb_array")
    try:
        policy = make_policy(RATING)
        replay = record_replay(env, policy, RECORDED_SEED)
        frame = env.render()
        assert frame is not None
        octomap = compare_with_octomap(
            collect_scans(env, policy, RECORDED_SEED),
            env.truth.occupied,
            env.scene.grid,
            settings.beam,
            settings.log_odds_range,
        )
    finally:
        env.close()
    log("a real stereo pair")
    return FieldStudy(
        size=size,
        settings=settings,
        evaluations=evaluations,
        octomap=octomap,
        frame=frame,
        replay=replay,
        stereo=stereo.run_stereo(np.random.default_rng(BOOTSTRAP_SEED)),
    )


def collect_scans(env: FieldEnv, policy: Policy, seed: int) -> list[Scan]:
    """The scans of an episode, in the order of their fusion."""
    scans: list[Scan] = []
    for _ in rollout(env, policy, seed):
        scans += env.last_scans
    return scans
