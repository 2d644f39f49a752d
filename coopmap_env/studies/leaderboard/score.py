"""Scores of submissions, from replays of all their episodes."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env import families
from coopmap_env.core.files import FileError
from coopmap_env.core.json_types import has_type
from coopmap_env.core.source_hash import source_hash
from coopmap_env.evaluation import BOOTSTRAP_SEED, Job, Result, run_jobs
from coopmap_env.evaluation.comparison import EFFICIENCY_SCORES
from coopmap_env.evaluation.statistics import Interval, bootstrap_mean
from coopmap_env.evaluation.tables import format_interval
from coopmap_env.studies.leaderboard.play import remembered_env
from coopmap_env.studies.leaderboard.private_worlds import Salt, world_seed
from coopmap_env.studies.leaderboard.replay import ReplayError, replay_episode
from coopmap_env.studies.leaderboard.reported import other_versions, own_versions
from coopmap_env.studies.leaderboard.submission import (
    Submission,
    SubmissionError,
    read_submission,
)
from coopmap_env.studies.leaderboard.world_bounds import episode_efficiency

SCORES = ("shown", "shown_auc", "coverage", "coverage_auc", "motion_distance")
"""Columns of `Episode.row` that are reported."""
FIELD_SCORES = ("surface_coverage", "surface_coverage_auc", "f_score")
"""Those of field families besides."""


@dataclass(frozen=True)
class Scored:
    """A submission of which every episode was replayed."""

    path: Path
    submission: Submission
    scores: dict[str, Interval]
    """Means over the worlds with 95 % intervals: `SCORES`, in the field `FIELD_SCORES`, and where
    bounds are known `EFFICIENCY_SCORES`."""
    by_world: dict[str, list[float]]
    """The same scores of each world."""

    @property
    def mode(self) -> str:
        """How the policy acts, in words."""
        options = self.submission["options"]
        n = f" ({options['n_candidates']})" if options["action_mode"] == "candidates" else ""
        return options["action_mode"] + n

    @property
    def notes(self) -> list[str]:
        """Versions that are not those of the replay."""
        return other_versions(self.submission["reported"]["versions"])


def score_file(
    path: Path,
    salt: Salt | None = None,
    bounds: Path | None = None,
    workers: int = 1,
    progress: bool = True,
    replays: Path | None = None,
) -> Scored:
    """Replay all episodes of a submission and score them.

    Parameters
    ----------
    path : Path
    salt : Salt, optional
        Needed if the worlds are private.
    bounds : Path, optional
        Folder in which the bounds of worlds are kept; those that are missing are searched. Without
        it there are no efficiencies.
    workers : int
        Episodes at a time; the result does not depend on it.
    progress : bool
        Show a bar.
    replays : Path, optional
        Folder in which finished replays are kept, with their efficiencies. They count again as long
        as the episode's record, the modules of coopmap, the versions of libraries and the folder of
        the bounds are the same; bounds that are kept there are not read again. By default
        everything is replayed.

    Raises
    ------
    SubmissionError
        With the file, if it is broken or a replay contradicts it.
    FileError
        If the salt is missing or another one, or a file of a bound is not right.
    """
    submission = read_submission(path)
    used = _salt_of(path, submission, salt)
    has_bounds = bounds is not None and not _is_field(submission)
    jobs: list[Job] = [
        {
            "family": submission["family"],
            "options": submission["options"],
            "seed": world_seed(used, submission["family"], record["world"]),
            "is_private": used is not None,
            "record": record,
            "bounds": None if bounds is None else str(bounds.resolve()),
            "versions": {**own_versions(), "sources": source_hash()},
        }
        for record in submission["episodes"]
    ]
    try:
        with _folder_of(replays) as folder:
            found = run_jobs(
                score_job, jobs, folder, workers, progress, is_valid=partial(_is_result, has_bounds)
            )
    except ReplayError as error:
        raise SubmissionError(f"{path}: does not replay: {error}") from error
    records = submission["episodes"]
    names: tuple[str, ...] = SCORES
    if _is_field(submission):
        names += FIELD_SCORES
    columns = {name: [_defined(record["scores"][name]) for record in records] for name in names}
    if found[0]["efficiency"] is not None:
        pairs = zip(*(one["efficiency"] for one in found), strict=True)
        columns |= dict(zip(EFFICIENCY_SCORES, map(list, pairs), strict=True))
    rng = np.random.default_rng(BOOTSTRAP_SEED)
    scores = {name: bootstrap_mean(values, rng) for name, values in columns.items()}
    return Scored(path, submission, scores, columns)


@contextmanager
def _folder_of(replays: Path | None) -> Iterator[Path]:
    """The folder of kept replays, or an empty one for the time of the context."""
    if replays is not None:
        yield replays
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


def _is_field(submission: Submission) -> bool:
    return families.get(submission["family"]).env_name == "field"


def _is_result(has_bounds: bool, value: Any) -> bool:
    """Whether a kept replay can be used; it has an efficiency if there are bounds."""
    if not has_type(value, dict[str, list[float] | None]) or set(value) != {"efficiency"}:
        return False
    pair = value["efficiency"]
    if pair is None:
        return not has_bounds
    return (
        has_bounds
        and len(pair) == len(EFFICIENCY_SCORES)
        and all(math.isfinite(score) for score in pair)
    )


def _defined(score: float | None) -> float:
    assert score is not None  # of `SCORES`, all are
    return score


def _salt_of(path: Path, submission: Submission, salt: Salt | None) -> Salt | None:
    """The salt of a submission's worlds; None if they are not private."""
    stated = submission["private"]
    if stated is None:
        return None
    if salt is None:
        raise FileError(
            f"{path}: its worlds are private: give the salt with the hash {stated} by --salt"
        )
    if salt.digest != stated:
        raise FileError(
            f"{path}: its private worlds belong to the salt with the hash {stated}, and the one "
            f"given has {salt.digest}"
        )
    return salt


def score_job(job: Job) -> Result:
    """Replay the episode of a job; its efficiency, or None without a bound.

    Raises
    ------
    ReplayError
        With the world and what differs.
    """
    env, family = remembered_env(job["family"], job["options"]), families.get(job["family"])
    episode = replay_episode(env, family, job["seed"], job["record"], job["is_private"])
    if job["bounds"] is None:
        return {"efficiency": None}
    return {
        "efficiency": episode_efficiency(env, family, job["seed"], episode, Path(job["bounds"]))
    }


def expand(paths: Sequence[Path]) -> list[Path]:
    """The files of some paths: themselves, and all ``*.json`` and ``*.json.gz`` of folders.

    Each once.

    Raises
    ------
    FileError
        If a folder has none.
    """
    files: dict[Path, Path] = {}
    for path in paths:
        inside = [path]
        if path.is_dir():
            inside = sorted([*path.glob("*.json"), *path.glob("*.json.gz")])
        if not inside:
            raise FileError(f"{path} has no *.json and no *.json.gz")
        for file in inside:
            files.setdefault(file.resolve(), file)
    return list(files.values())


def line(scored: Scored) -> str:
    """A submission in one line of text."""
    submission, scores = scored.submission, scored.scores
    parts = [
        f"{submission['policy']:<40} {submission['family']}, {submission['n_worlds']} "
        f"{'private ' if submission['private'] else ''}worlds, {scored.mode}",
        *(
            f"{title} {format_interval(scores[name], 100, 1)} %"
            for title, name in (
                ("efficiency: end", "efficiency"),
                ("area", "efficiency_auc"),
                ("shown", "shown"),
                ("surface", "surface_coverage"),
            )
            if name in scores
        ),
        f"motion {scores['motion_distance']:.1f}",
        f"decision {submission['reported']['decision_ms']:.3f} ms (reported)",
        f"model {', '.join(model_size_texts(submission)) or '-'}",
    ]
    return "   ".join(parts)


def model_size_texts(submission: Submission) -> list[str]:
    """Size of the model, as it is reported: parameters and bytes, as far as they are given."""
    reported = submission["reported"]
    n_parameters, n_bytes = reported["n_parameters"], reported["model_bytes"]
    return [
        *([] if n_parameters is None else [f"{n_parameters:,} parameters"]),
        *([] if n_bytes is None else [f"{n_bytes / 1e6:.2f} MB"]),
    ]
