"""The command `coopmap evaluate`."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.results import command_line, new_results_path
from coopmap_env.core.progress import log
from coopmap_env.envs.arguments import SplitName

MAX_EPISODES = 1_000_000
"""More would take months, and all memory for their list."""


@dataclass(frozen=True, kw_only=True)
class Evaluate(EnvironmentOptions):
    """Compare policies on the same worlds.

    Writes episodes.csv (one row per policy and world), summary.json (means, interquartile means,
    probability of improvement over the first policy; 95 % bootstrap intervals), report.md (table,
    command, versions), and with the extra report figure.png. `coopmap report` compares the folders
    of several runs.

    Such as:
      coopmap evaluate --policies rating_function:search=100,raster --episodes 50
      coopmap evaluate --policies frontier,random --scene my_map.yaml --max-scans 32 --out results/m
      coopmap evaluate --policies rating_function:search=50+coordination=sequential --out results/s
      coopmap evaluate --env field --policies rating_function,random --episodes 4 --out results/f
      coopmap evaluate --policies learned,rating_function --action-mode candidates --out results/l
    """

    PURPOSE: ClassVar[str] = "play and compare policies"

    out: Path = field(default_factory=partial(new_results_path, "evaluate"))
    """Folder of the results. With that of an interrupted run, it goes on."""
    policies: str = "rating_function:search=100,raster"
    """Names with options, separated by commas: name:key=value+key=value."""
    episodes: int = 50
    """Worlds for each policy."""
    split: SplitName = "test"
    """Split of the worlds."""
    seed: int = 0
    """Seed of the first world. The other worlds have the following seeds."""
    efficiency: bool = False
    """Compare with a bound of what any policy can show in a world. It takes seconds for each, and
    adds the columns efficiency and efficiency_auc. The certificates are kept in the folder bounds.
    Planar only."""
    workers: int = 1
    """Episodes at a time. Only planning times depend on it."""
    backend: Literal["processes", "ray"] = "processes"
    """Kind of the workers: processes of this machine, or tasks of Ray (extra ray). Ray runs them on
    the cluster that the environment variable RAY_ADDRESS names ("auto": the one of this machine).
    Its nodes need this package and the files named here. Without RAY_ADDRESS, Ray runs on this
    machine."""

    def extras(self) -> list[str]:
        """Extras that the environment and the workers need."""
        return [*super().extras(), *(["ray"] if self.backend == "ray" else [])]

    def run(self) -> None:
        """Play all episodes, write the files, print a summary."""
        from coopmap_env.core.locks import folder_lock
        from coopmap_env.evaluation import check_policy
        from coopmap_env.evaluation.report import missing_figure_text

        names = [name.strip() for name in self.policies.split(",") if name.strip()]
        if not names:
            raise ValueError("--policies names no policy")
        for name in names:
            check_policy(name)
        self.env_kwargs()
        if self.episodes < 1:
            raise ValueError(f"--episodes must be at least 1, got {self.episodes}")
        if self.episodes > MAX_EPISODES:
            raise ValueError(f"--episodes must be at most {MAX_EPISODES:,}, got {self.episodes}")
        if self.efficiency and self.env_name != "planar":
            raise ValueError(
                f"--efficiency needs bounds, which only planar worlds have, not {self.env_name}"
            )
        with folder_lock(self.out):
            results = self._play_and_write(names)
        for name, result in results.items():
            print(f"{name:<40} {summary_line(result.table)}")
        if missing := missing_figure_text():
            log(missing)
        log(f"coopmap report {self.out} compares it with other runs")

    def _play_and_write(self, names: list[str]) -> dict[str, Any]:
        """Play all episodes and write the files; evaluations by policy."""
        from coopmap_env import evaluation
        from coopmap_env.core.files import write_atomically
        from coopmap_env.core.settings import settings_to_dict
        from coopmap_env.core.version import __version__
        from coopmap_env.evaluation import write_episodes
        from coopmap_env.evaluation.report import write_report
        from coopmap_env.evaluation.saved_run import SavedRun, save_run

        arguments = {**self.env_kwargs(), "split": self.split}
        seeds = range(self.seed, self.seed + self.episodes)
        results = evaluation.compare(
            names,
            seeds,
            arguments,
            self.out / "episodes",
            self.settings(),
            self.workers,
            env_name=self.env_name,
            backend=self.backend,
        )
        env = self.make_env(self.split)
        if self.efficiency:
            results = evaluation.with_efficiencies(
                results, seeds, arguments, self.out / "bounds", self.settings(), self.workers
            )
        played = {
            "id": env.metadata["name"],
            **arguments,
            "settings": settings_to_dict(env.settings),
        }
        summary = {
            "version": __version__,
            "env": played,
            "policies": evaluation.summarize(results, names[0]),
        }
        run = SavedRun(played, results)
        save_run(run, self.out)
        title = f"{env.metadata['name']}, split {self.split}"
        write_report(run, self.out, title, command=command_line("evaluate", self))
        write_episodes(results, self.out / "episodes.csv")
        write_atomically(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        return results


def summary_line(table: dict[str, Any]) -> str:
    """Means of one policy's main scores over its worlds."""
    parts = [
        f"coverage {100 * table['coverage'].mean():6.2f} %",
        f"area under curve {100 * table['coverage_auc'].mean():6.2f} %",
        f"motion {table['motion_distance'].mean():7.1f}",
        f"planning {table['planning_time_ms'].mean():7.3f} ms",
    ]
    if "efficiency" in table:
        parts[2:2] = [
            f"efficiency {100 * table['efficiency'].mean():5.1f} %",
            f"of area {100 * table['efficiency_auc'].mean():5.1f} %",
        ]
    if "surface_coverage" in table:
        parts[2:2] = [
            f"surface {100 * table['surface_coverage'].mean():6.2f} %",
            f"F {table['f_score'].mean():5.3f}",
        ]
    return "   ".join(parts)
