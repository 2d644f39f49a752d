"""The command `coopmap`: reproduce, evaluate, bench."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from coopmap_env.extras import require


@dataclass(frozen=True)
class Reproduce:
    """Run Section 3 of the paper over many worlds and write a report.

    Writes report.html, table1.csv, figure7.png, figure8.png, summary.json and more pictures into
    the folder, and prints Table 1 beside the paper's. An interrupted run goes on where it was.

    Such as:
      coopmap reproduce --out results/section3 --quick
      coopmap reproduce --out results/section3 --workers 2
    """

    out: Path
    """Folder of the results."""
    quick: bool = False
    """Fewer worlds: under two minutes instead of about half an hour."""
    workers: int = 1
    """Processes; the numbers do not depend on it."""

    def run(self) -> None:
        """Run the study, write its files, print the table."""
        from coopmap_env.evaluation import report, section3

        size = section3.QUICK if self.quick else section3.FULL
        study = section3.run(self.out / "episodes", size, self.workers, _say)
        report.write_report(study, self.out)
        print(report.text_table_1(study))
        _say(f"report: {self.out / 'report.html'}")


@dataclass(frozen=True)
class Evaluate:
    """Compare policies on the same worlds.

    Writes episodes.csv (one row per policy and world) and summary.json (means, interquartile
    means, probability of improvement over the first policy; 95 % bootstrap intervals).

    Such as:
      coopmap evaluate --policies rating_function:search=100,raster --episodes 50 --out results/e
      coopmap evaluate --policies frontier,random --scene my_map.yaml --max-scans 32 --out results/m
      coopmap evaluate --policies rating_function:search=50+coordination=sequential --out results/s
    """

    out: Path
    """Folder of the results."""
    policies: str = "rating_function:search=100,raster"
    """Names with options: name:key=value+key=value, separated by commas."""
    env: Literal["planar"] = "planar"
    """Environment."""
    episodes: int = 50
    """Worlds for each policy."""
    split: Literal["train", "validation", "test"] = "test"
    """Where the worlds come from."""
    seed: int = 0
    """Seed of the first world; the others follow."""
    scene: str = "obstacles"
    """obstacles, rooms, house, or the path of a ROS map_server YAML file."""
    robots: int = 2
    """Robots in the team."""
    max_scans: int = 16
    """Scans of each robot."""
    action_mode: Literal["pose", "candidates"] = "pose"
    """Free poses within reach, or a choice among random candidates."""
    n_candidates: int = 32
    """m, in candidates mode."""
    reward: Literal["rating", "information", "coverage"] = "rating"
    """The reward that is summed up."""
    workers: int = 1
    """Processes; the numbers do not depend on it, planning times apart."""

    def run(self) -> None:
        """Play all episodes, write the files, print a summary."""
        import coopmap_env
        from coopmap_env import evaluation, planar_v0
        from coopmap_env.evaluation.comparison import write_episodes
        from coopmap_env.evaluation.jobs import write_atomically
        from coopmap_env.evaluation.serial import settings_to_dict

        names = [name.strip() for name in self.policies.split(",") if name.strip()]
        if not names:
            raise ValueError("--policies names no policy")
        if self.episodes < 1:
            raise ValueError(f"--episodes must be at least 1, got {self.episodes}")
        env: dict[str, Any] = {
            "n_robots": self.robots,
            "scene": self.scene,
            "split": self.split,
            "max_scans": self.max_scans,
            "action_mode": self.action_mode,
            "n_candidates": self.n_candidates,
            "reward": self.reward,
        }
        results = evaluation.compare(
            names,
            range(self.seed, self.seed + self.episodes),
            env,
            self.out / "episodes",
            workers=self.workers,
        )
        settings = planar_v0.parallel_env(**env).settings
        summary = {
            "version": coopmap_env.__version__,
            "env": {"id": "coopmap/Planar-v0", **env, "settings": settings_to_dict(settings)},
            "policies": evaluation.summarize(results, names[0]),
        }
        write_episodes(results, self.out / "episodes.csv")
        write_atomically(self.out / "summary.json", json.dumps(summary, indent=2) + "\n")
        for name, result in results.items():
            table = result.table
            print(
                f"{name:<40} coverage {100 * table['coverage'].mean():6.2f} %"
                f"   area under curve {100 * table['coverage_auc'].mean():6.2f} %"
                f"   motion {table['motion_cost'].mean():7.1f}"
                f"   planning {table['planning_ms'].mean():7.3f} ms"
            )
        _say(f"tables: {self.out / 'episodes.csv'}, {self.out / 'summary.json'}")


@dataclass(frozen=True)
class Bench:
    """Measure steps per second, decision times and memory, beside mpe2's simple_spread.

    Everything runs in one process on one core, interleaved, so that ratios mean something on a
    busy machine too.

    Such as:
      coopmap bench --out results/bench.json
    """

    out: Path
    """JSON file of the results."""
    rounds: int = 5
    """Repetitions, of which the median counts."""

    def run(self) -> None:
        """Measure, write the file, print it."""
        from coopmap_env.evaluation.bench import measure
        from coopmap_env.evaluation.jobs import write_atomically

        if self.rounds < 1:
            raise ValueError(f"--rounds must be at least 1, got {self.rounds}")
        figures = measure(self.rounds, _say)
        text = json.dumps(figures, indent=2)
        write_atomically(self.out, text + "\n")
        print(text)


INTERRUPTED = 130
"""What shells expect of a command that ended by an interrupt."""


def parse(arguments: list[str] | None = None) -> Reproduce | Evaluate | Bench:
    """The command that the arguments (default: those of the process) ask for."""
    tyro = require("tyro", "cli")
    command: Reproduce | Evaluate | Bench = tyro.extras.subcommand_cli_from_dict(
        {"reproduce": Reproduce, "evaluate": Evaluate, "bench": Bench},
        prog="coopmap",
        description="Cooperative active mapping: environments, planners, evaluation.",
        args=arguments,
    )
    return command


def main(arguments: list[str] | None = None) -> None:
    """Entry point: one clear line and exit status 1 on bad input."""
    try:
        parse(arguments).run()
    except KeyboardInterrupt:
        _say("interrupted; finished episodes are kept, the same command goes on with the rest")
        raise SystemExit(INTERRUPTED) from None
    except (ValueError, ImportError, OSError) as error:
        raise SystemExit(f"coopmap: {' '.join(str(error).split())}") from None


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
