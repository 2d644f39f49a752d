"""The command `coopmap replay`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar, Literal

from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.results import new_results_path
from coopmap_env.envs.arguments import SplitName


@dataclass(frozen=True, kw_only=True)
class Replay(EnvironmentOptions):
    """Play one episode and write it as one offline HTML page with a timeline.

    Such as:
      coopmap replay --env planar
      coopmap replay --family crowded --policy frontier --efficiency --out results/crowded.html
      coopmap replay --policy random --scene rubble --n-robots 3 --seed 7 --out results/rubble.html
    """

    PURPOSE: ClassVar[str] = "play and compare policies"
    DEFAULT_ENV: ClassVar[Literal["planar", "field"]] = "field"

    out: Path = field(default_factory=partial(new_results_path, "replay", ".html"))
    """The HTML file."""
    env: Literal["planar", "field"] | None = None
    """3-D (field, the default) or 2-D (planar, which needs no extra)."""
    policy: str = "rating_function:search=100"
    """Name with options: name:key=value+key=value."""
    split: SplitName = "test"
    """Split of the world."""
    seed: int = 0
    """Seed of the world."""
    efficiency: bool = False
    """Compare with a bound of what any policy can show. It takes seconds. Planar only."""

    def extras(self) -> list[str]:
        """Extras that the page needs."""
        return [*super().extras(), *(["replay"] if self.env_name == "field" else [])]

    def run(self) -> None:
        """Play the episode and write the file."""
        if self.efficiency and self.env_name != "planar":
            raise ValueError(
                f"--efficiency needs bounds, which only planar worlds have, not {self.env_name}"
            )
        from coopmap_env.evaluation import make_policy
        from coopmap_env.evaluation.replay import PlanarReplay, record_replay, write_replay

        policy = make_policy(self.policy)
        env = self.make_env(self.split, report_shown=self.efficiency)
        try:
            replay = record_replay(env, policy, self.seed, efficiency=self.efficiency)
            if isinstance(replay, PlanarReplay):  # the field's page has no room for the policy
                replay = replace(replay, title=f"{replay.title}: {self.policy}")
            write_replay(replay, self.out)
        finally:
            env.close()
