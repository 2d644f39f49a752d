"""The command `coopmap replay`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from coopmap_env.cli.environment import parse_mounts
from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Replay:
    """Play one field episode and write it as one offline HTML page with a timeline.

    Such as:
      coopmap replay --out results/replay.html
      coopmap replay --policy random --scene rubble --n-robots 3 --seed 7 --out results/rubble.html
    """

    out: Path
    """The HTML file."""
    policy: str = "rating_function:search=100"
    """Name with options: name:key=value+key=value."""
    scene: str = "worksite"
    """worksite, clutter, rubble, or a YAML file of meshes."""
    mount: str = "mast"
    """mast, husky_panda or tiago; or one for each robot, separated by commas."""
    physics: Literal["kinematic", "stepped"] = "kinematic"
    """See FieldSettings.physics."""
    initialization: Literal["located", "search"] = "located"
    """Whether robots know their base poses, or localize themselves on the target first."""
    motion_correction: Literal["kinematic", "fiducials", "exact"] = "kinematic"
    """How camera poses are estimated."""
    n_robots: int = 2
    """Robots in the team."""
    max_scans: int = 16
    """Scans of each robot."""
    split: Literal["train", "validation", "test"] = "test"
    """Split of the world."""
    seed: int = 0
    """Seed of the world."""

    def run(self) -> None:
        """Play the episode and write the file."""
        from coopmap_env import field_v0
        from coopmap_env.evaluation import make_policy
        from coopmap_env.evaluation.replay import record_replay, write_replay

        policy = make_policy(self.policy)
        env = field_v0.parallel_env(
            n_robots=self.n_robots,
            mount=parse_mounts(self.mount),
            scene=self.scene,
            split=self.split,
            max_scans=self.max_scans,
            settings=field_v0.FieldSettings(physics=self.physics),
            initialization=self.initialization,
            motion_correction=self.motion_correction,
        )
        try:
            write_replay(record_replay(env, policy, self.seed), self.out)
        finally:
            env.close()
        log(f"replay: {self.out}")
