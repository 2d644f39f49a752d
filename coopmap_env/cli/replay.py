"""The command `coopmap replay`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.results import new_results_path
from coopmap_env.envs.arguments import SplitName


@dataclass(frozen=True, kw_only=True)
class Replay(EnvironmentOptions):
    """Play one field episode and write it as one offline HTML page with a timeline.

    Such as:
      coopmap replay
      coopmap replay --policy random --scene rubble --n-robots 3 --seed 7 --out results/rubble.html
    """

    PURPOSE: ClassVar[str] = "play and compare policies"
    DEFAULT_ENV: ClassVar[Literal["planar", "field"]] = "field"

    out: Path = field(default_factory=partial(new_results_path, "replay", ".html"))
    """The HTML file."""
    env: Literal["field"] | None = None
    """Only field episodes have a replay."""
    policy: str = "rating_function:search=100"
    """Name with options: name:key=value+key=value."""
    split: SplitName = "test"
    """Split of the world."""
    seed: int = 0
    """Seed of the world."""

    def extras(self) -> list[str]:
        """Extras that the page needs."""
        return [*super().extras(), "replay"]

    def run(self) -> None:
        """Play the episode and write the file."""
        if self.env_name != "field":
            raise ValueError(
                f"only field episodes have a replay, and --family {self.family} is "
                f"{self.env_name}: choose a family of field worlds"
            )
        from coopmap_env.evaluation import make_policy
        from coopmap_env.evaluation.replay import record_replay, write_replay

        policy = make_policy(self.policy)
        env = self.make_env(self.split)
        try:
            write_replay(record_replay(env, policy, self.seed), self.out)
        finally:
            env.close()
