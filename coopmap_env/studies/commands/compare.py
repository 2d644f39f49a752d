"""The command `coopmap compare`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Compare:
    """Compare the pretrained policies with the planners on the same test worlds.

    Writes report.html, summary.json, table.md, figures and a row for each episode into the folder.
    After an interruption, the same command continues. Needs the extras rl, report, cli and data,
    and the extra field for that environment.

    For example:
      coopmap compare --out results/comparison --quick
      coopmap compare --out results/comparison --workers 2
      coopmap compare --out results/comparison --envs planar
    """

    out: Path
    """Folder of the results."""
    quick: bool = False
    """A few worlds for each condition, as a trial."""
    workers: int = 1
    """Processes; the results do not depend on it, except planning times."""
    envs: str = "planar,field"
    """Environments, separated by commas."""

    def run(self) -> None:
        """Run the comparison, write its files, print its table and verdicts."""
        from coopmap_env.studies.benchmark import methods, study
        from coopmap_env.studies.benchmark.report import text_summary, write_benchmark_report

        size = methods.QUICK if self.quick else methods.FULL
        names = [name.strip() for name in self.envs.split(",") if name.strip()]
        plan = methods.make_plan(size, names)
        results = study.run(self.out / "episodes", plan, self.workers, log)
        print(text_summary(write_benchmark_report(results, self.out)))
        log(f"report: {self.out / 'report.html'}")
