"""The command `coopmap record`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.evaluate import MAX_EPISODES
from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log
from coopmap_env.envs.arguments import SplitName


@dataclass(frozen=True, kw_only=True)
class Record(EnvironmentOptions):
    """Record episodes of a policy for offline learning.

    Writes what the team saw, did and got as a Minari dataset: HDF5 and JSON, no code. After an
    interruption, the same command with --out continues. Needs the extra record.

    Such as:
      coopmap record --policy rating_function:search=100 --episodes 200 --workers 2
      coopmap record --family crowded --policy frontier --action-mode candidates --out results/data
      coopmap record --env field --policy surface --episodes 50 --out results/field-data
    """

    PURPOSE: ClassVar[str] = "train policies"

    out: Path = field(default_factory=partial(new_results_path, "record"))
    """Folder of the dataset. Finished episodes are kept in its folder episodes, which can be
    removed afterwards."""
    policy: str = "rating_function:search=100"
    """Name with options: name:key=value+key=value."""
    episodes: int = 50
    """Worlds."""
    split: SplitName = "train"
    """Split of the worlds."""
    seed: int = 0
    """Seed of the first world. The other worlds have the following seeds."""
    dataset_id: str | None = None
    """Name for Minari, NAMESPACE/NAME-vN. By default of the environment and the policy, such as
    coopmap/planar/frontier-v0."""
    workers: int = 1
    """Episodes at a time. The dataset does not depend on it."""

    def extras(self) -> list[str]:
        """Extras that the environment and the files need."""
        return [*super().extras(), "record"]

    def run(self) -> None:
        """Play all episodes and write the dataset."""
        from coopmap_env.evaluation import check_policy

        check_policy(self.policy)
        arguments = {**self.env_kwargs(), "split": self.split}
        if not 1 <= self.episodes <= MAX_EPISODES:
            raise ValueError(f"--episodes must be from 1 to {MAX_EPISODES:,}, got {self.episodes}")
        if self.seed < 0:
            raise ValueError(f"--seed must be at least 0, got {self.seed}")
        from coopmap_env.evaluation.offline import default_dataset_id, record_dataset

        dataset = record_dataset(
            self.policy,
            range(self.seed, self.seed + self.episodes),
            arguments,
            self.out,
            self.settings(),
            self.env_name,
            self.dataset_id or default_dataset_id(self.policy, self.family or self.env_name),
            self.workers,
        )
        n_bytes = dataset.path.stat().st_size
        log(f"{len(dataset)} episodes, {n_bytes / 1e6:.1f} MB: {dataset.path}")
