"""The command `coopmap evaluate`."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from coopmap_env.cli.output import say


@dataclass(frozen=True)
class Evaluate:
    """Compare policies on the same worlds.

    Writes episodes.csv (one row per policy and world) and summary.json (means, interquartile
    means, probability of improvement over the first policy; 95 % bootstrap intervals).

    Such as:
      coopmap evaluate --policies rating_function:search=100,raster --episodes 50 --out results/e
      coopmap evaluate --policies frontier,random --scene my_map.yaml --max-scans 32 --out results/m
      coopmap evaluate --policies rating_function:search=50+coordination=sequential --out results/s
      coopmap evaluate --env field --policies rating_function,random --episodes 4 --out results/f
    """

    out: Path
    """Folder of the results."""
    policies: str = "rating_function:search=100,raster"
    """Names with options: name:key=value+key=value, separated by commas."""
    env: Literal["planar", "field"] = "planar"
    """Environment; "field" needs the extra of that name."""
    episodes: int = 50
    """Worlds for each policy."""
    split: Literal["train", "validation", "test"] = "test"
    """Where the worlds come from."""
    seed: int = 0
    """Seed of the first world; the others follow."""
    scene: str = ""
    """planar: obstacles (default), rooms, house, or a ROS map_server YAML file; field: worksite
    (default), clutter, rubble, or a YAML file of meshes."""
    mount: str = ""
    """field: mast (default), husky_panda or tiago; or one for each robot, separated by commas."""
    physics: Literal["", "kinematic", "stepped"] = ""
    """field: kinematic (default) or stepped; see FieldSettings.physics."""
    initialization: Literal["", "located", "search"] = ""
    """field: located (default), or search: robots have to find the target first."""
    motion_correction: Literal["", "kinematic", "fiducials", "exact"] = ""
    """field: where cameras are taken to be; kinematic (default)."""
    robots: int = 2
    """Robots in the team."""
    max_scans: int = 16
    """Scans of each robot."""
    action_mode: Literal["pose", "candidates"] = "pose"
    """Any pose (in the field: joints of the mount), or a choice among random candidates."""
    n_candidates: int = 32
    """m, in candidates mode."""
    reward: Literal["rating", "information", "coverage"] = "rating"
    """The reward that is summed up."""
    workers: int = 1
    """Processes; the numbers do not depend on it, planning times apart."""

    def run(self) -> None:
        """Play all episodes, write the files, print a summary."""
        import coopmap_env
        from coopmap_env import evaluation
        from coopmap_env.evaluation.comparison import write_episodes
        from coopmap_env.evaluation.jobs import write_atomically
        from coopmap_env.evaluation.serial import settings_to_dict
        from coopmap_env.evaluation.worlds import kind_of

        names = [name.strip() for name in self.policies.split(",") if name.strip()]
        if not names:
            raise ValueError("--policies names no policy")
        if self.episodes < 1:
            raise ValueError(f"--episodes must be at least 1, got {self.episodes}")
        for name in ("mount", "physics", "initialization", "motion_correction"):
            if self.env != "field" and getattr(self, name):
                option = name.replace("_", "-")
                raise ValueError(f"--{option} belongs to --env field, not to --env {self.env}")
        arguments, kind = self.arguments(), kind_of(self.env)
        settings = None
        if self.env == "field":
            settings = kind.settings(physics=self.physics or "kinematic")
        results = evaluation.compare(
            names,
            range(self.seed, self.seed + self.episodes),
            arguments,
            self.out / "episodes",
            settings,
            self.workers,
            world=self.env,
        )
        made = kind.env(**arguments, settings=settings)
        summary = {
            "version": coopmap_env.__version__,
            "env": {
                "id": made.metadata["name"],
                **arguments,
                "settings": settings_to_dict(made.settings),
            },
            "policies": evaluation.summarize(results, names[0]),
        }
        write_episodes(results, self.out / "episodes.csv")
        write_atomically(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        for name, result in results.items():
            print(f"{name:<40} {summary_line(result.table)}")
        say(f"tables: {self.out / 'episodes.csv'}, {self.out / 'summary.json'}")

    def arguments(self) -> dict[str, Any]:
        """Arguments of the environment."""
        arguments: dict[str, Any] = {
            "n_robots": self.robots,
            "split": self.split,
            "max_scans": self.max_scans,
            "action_mode": self.action_mode,
            "n_candidates": self.n_candidates,
            "reward": self.reward,
        }
        if self.scene:
            arguments["scene"] = self.scene
        if self.mount:
            arguments["mount"] = mounts_of(self.mount)
        for name in ("initialization", "motion_correction"):
            if getattr(self, name):
                arguments[name] = getattr(self, name)
        return arguments


def mounts_of(text: str) -> str | list[str]:
    """One mount for all robots, or one for each where there is a comma."""
    return text.split(",") if "," in text else text


def summary_line(table: dict[str, Any]) -> str:
    """The main scores of one policy, averaged over its worlds."""
    parts = [
        f"coverage {100 * table['coverage'].mean():6.2f} %",
        f"area under curve {100 * table['coverage_auc'].mean():6.2f} %",
        f"motion {table['motion_cost'].mean():7.1f}",
        f"planning {table['planning_ms'].mean():7.3f} ms",
    ]
    if "surface" in table:
        parts[2:2] = [
            f"surface {100 * table['surface'].mean():6.2f} %",
            f"F {table['f_score'].mean():5.3f}",
        ]
    return "   ".join(parts)
