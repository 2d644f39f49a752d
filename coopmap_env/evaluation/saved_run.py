"""The episodes of a comparison in one file, for reports of several runs."""

from __future__ import annotations

import json
import os
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from coopmap_env.core.files import FileError, read_json, write_atomically
from coopmap_env.core.version import __version__
from coopmap_env.evaluation.comparison import Evaluation
from coopmap_env.evaluation.episode import episode_from_dict
from coopmap_env.evaluation.stored_episode import is_episode
from coopmap_env.evaluation.summary import summarize

RUN_FILE = "run.json"
"""In the folder of a run."""


@dataclass(frozen=True)
class SavedRun:
    """What was played, and all episodes."""

    env: dict[str, Any]
    """Id, arguments and settings of the environment, as JSON values."""
    evaluations: dict[str, Evaluation]
    """By policy."""

    @property
    def n_robots(self) -> int:
        """Robots of the team."""
        return int(self.env["n_robots"])

    @cached_property
    def summary(self) -> dict[str, Any]:
        """Scores of each policy with intervals; see `summarize`."""
        return summarize(self.evaluations, None)


def save_run(run: SavedRun, folder: Path) -> None:
    """Write a run into its folder."""
    content = {
        "version": __version__,
        "env": run.env,
        "episodes": {
            name: [asdict(episode) for episode in evaluation.episodes]
            for name, evaluation in run.evaluations.items()
        },
    }
    write_atomically(folder / RUN_FILE, json.dumps(content) + "\n")


def load_run(folder: str | os.PathLike[str]) -> SavedRun:
    """Read the run of a folder, as `coopmap evaluate` writes it.

    Raises
    ------
    FileError
        With the file, if it is missing or broken.
    """
    path = Path(folder) / RUN_FILE
    if not path.is_file():
        raise FileError(f"{folder}: no {RUN_FILE} in it, which coopmap evaluate writes")
    content = read_json(path)
    played = content.get("episodes") if isinstance(content, dict) else None
    env = content.get("env") if isinstance(content, dict) else None
    if not isinstance(env, dict) or not isinstance(env.get("n_robots"), int):
        raise FileError(f"{path}: no env with n_robots")
    if not isinstance(played, dict) or not played or not all(map(_are_episodes, played.values())):
        raise FileError(f"{path}: no episodes of this version of coopmap by policy")
    return SavedRun(
        env,
        {
            name: Evaluation(tuple(map(episode_from_dict, episodes)))
            for name, episodes in played.items()
        },
    )


def _are_episodes(values: Any) -> bool:
    return isinstance(values, list) and bool(values) and all(map(is_episode, values))
