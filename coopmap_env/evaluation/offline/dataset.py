"""Reading recorded episodes."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any, TypedDict, overload

from gymnasium import spaces

from coopmap_env.core.files import FileError, read_json
from coopmap_env.core.json_types import has_type
from coopmap_env.envs import TeamEnv
from coopmap_env.evaluation.env_specs import make_team_env
from coopmap_env.evaluation.offline.episode import RecordedEpisode
from coopmap_env.evaluation.offline.hdf5_files import read_episode
from coopmap_env.evaluation.offline.minari_spaces import space_from_json

DATA_FOLDER, DATA_FILE, METADATA_FILE = "data", "main_data.hdf5", "metadata.json"
"""Names that Minari gives."""


class RecordingError(FileError):
    """A recorded dataset that is missing, broken, or of another form."""


class Recipe(TypedDict):
    """All that decides the arrays of a dataset."""

    format: int
    versions: dict[str, str]
    policy: str
    fingerprint: str
    files: dict[str, str]
    env_name: str
    env_kwargs: dict[str, Any]
    settings: dict[str, Any]
    seeds: list[int]


class RecordedDataset(Sequence[RecordedEpisode]):
    """The episodes of a folder that ``coopmap record`` has written; each is read when asked for.

    Parameters
    ----------
    folder : path-like
        The one given to ``--out``.

    Raises
    ------
    RecordingError
        If it has no dataset, or one of another form.

    Examples
    --------
    >>> dataset = RecordedDataset("results/frontier")
    >>> dataset[0].observations["map"].shape, dataset[0].rewards.sum()
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.path = Path(folder) / DATA_FOLDER / DATA_FILE
        """The file of all arrays."""
        path = Path(folder) / DATA_FOLDER / METADATA_FILE
        values = read_json(path, RecordingError)
        recipe: Any = values.get("coopmap") if isinstance(values, dict) else None
        if not _is_recipe(recipe):
            raise RecordingError(f"{path}: no metadata that coopmap record of this version writes")
        self.recipe: Recipe = recipe
        """Policy, seeds, environment and versions that decide the arrays."""
        try:
            observed = space_from_json(values.get("observation_space"))
            self.action_space = space_from_json(values.get("action_space"))
            if not isinstance(observed, spaces.Dict):
                raise ValueError("observations are no Dict")
        except ValueError as error:
            raise RecordingError(f"{path}: {error}") from error
        self.observation_space = observed

    def __len__(self) -> int:
        return len(self.recipe["seeds"])

    @overload
    def __getitem__(self, index: int) -> RecordedEpisode: ...
    @overload
    def __getitem__(self, index: slice) -> list[RecordedEpisode]: ...
    def __getitem__(self, index: int | slice) -> RecordedEpisode | list[RecordedEpisode]:
        if isinstance(index, slice):
            return [self[k] for k in range(*index.indices(len(self)))]
        k = range(len(self))[index]
        episode = read_episode(
            self.path, f"episode_{k}", self.observation_space, self.action_space, RecordingError
        )
        if episode.seed != self.recipe["seeds"][k]:
            raise RecordingError(f"{self.path}: episode_{k} is not of the seed in the metadata")
        return episode

    def make_env(self) -> TeamEnv:
        """Make the environment that it was recorded in, in the same split.

        Files that its arguments name, such as scenes, must be where they were.
        """
        recipe = self.recipe
        return make_team_env(recipe["env_name"], recipe["env_kwargs"], recipe["settings"])


def _is_recipe(value: Any) -> bool:
    if not isinstance(value, dict):
        return False
    objects = {name: value.get(name) for name in ("env_kwargs", "settings")}
    return (
        all(isinstance(each, dict) for each in objects.values())
        and has_type({**value, "env_kwargs": {}, "settings": {}}, Recipe)
        and all(seed >= 0 for seed in value["seeds"])
    )
