"""The command `coopmap compare`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Compare:
    """Compare the pretrained policies with the strongest planners on the same test worlds.

    Writes report.html, summary.json, table.md, figures and a row for each episode into the folder.
    After an interruption, the same command with --out continues. Needs the extras rl, report and
    data, and the extra field for that environment.

    For example:
      coopmap compare --out results/comparison --quick
      coopmap compare --out results/comparison --workers 2
      coopmap compare --out results/planar --envs planar --n-worlds 24 --no-generalization
    """

    PURPOSE: ClassVar[str] = "studies of the paper and of this benchmark"

    out: Path = field(default_factory=partial(new_results_path, "compare"))
    """Folder of the results. With that of an interrupted run, it goes on."""
    quick: bool = False
    """A few worlds for each condition, as a trial."""
    workers: int = 1
    """Processes. The results do not depend on it, except planning times."""
    envs: str = "planar,field"
    """Environments, separated by commas."""
    n_worlds: int | None = None
    """At most this many worlds for each condition. All of the full comparison by default."""
    generalization: bool = True
    """Whether to play the conditions that differ from the training, too."""

    def extras(self) -> list[str]:
        """Extras of the policies, the report and the environments."""
        return ["rl", "report", "data", *(["field"] if "field" in self.envs else [])]

    def run(self) -> None:
        """Run the comparison, write its files, print its table and verdicts."""
        from coopmap_env.core.locks import folder_lock
        from coopmap_env.studies.benchmark.plan import FULL, QUICK, make_plan
        from coopmap_env.studies.benchmark.report import write_benchmark_report
        from coopmap_env.studies.benchmark.study import run_benchmark
        from coopmap_env.studies.benchmark.tables import benchmark_text

        names = [name.strip() for name in self.envs.split(",") if name.strip()]
        size = QUICK if self.quick else FULL
        if self.n_worlds is not None:
            size = size.at_most(self.n_worlds)
        plan = make_plan(size, names)
        for note in plan.notes:
            log(f"note: {note}")
        if not self.generalization:
            plan = replace(plan, generalization=())
        with folder_lock(self.out):
            study = run_benchmark(self.out / "episodes", plan, self.workers, log)
            summary = write_benchmark_report(study, self.out)
        print(benchmark_text(summary))
        log(f"report: {self.out / 'report.html'}")
