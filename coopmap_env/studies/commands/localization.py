"""The command `coopmap localization`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Localization:
    """Study target registration and the correction of camera poses by fiducials.

    Writes report.html, summary.json and figures into the folder. After an interruption, the same
    command with --out continues. Needs the extras field and report.

    For example:
      coopmap localization --out results/localization --quick
      coopmap localization --out results/localization --workers 2
    """

    PURPOSE: ClassVar[str] = "studies of the paper and of this benchmark"

    out: Path = field(default_factory=partial(new_results_path, "localization"))
    """Folder of the results. With that of an interrupted run, it goes on."""
    quick: bool = False
    """Fewer worlds. They take about one minute instead of ten."""
    workers: int = 1
    """Processes. The results do not depend on it, except times."""

    def extras(self) -> list[str]:
        """Extras of the environment and the report."""
        return ["field", "report"]

    def run(self) -> None:
        """Run the study, write its files, print the main results."""
        from coopmap_env.core.locks import folder_lock
        from coopmap_env.studies.localization.report import (
            localization_text,
            write_localization_report,
        )
        from coopmap_env.studies.localization.study import FULL, QUICK, run_localization_study

        size = QUICK if self.quick else FULL
        with folder_lock(self.out):
            study = run_localization_study(self.out / "episodes", size, self.workers, log)
            summary = write_localization_report(study, self.out)
        print(localization_text(summary))
        log(f"report: {self.out / 'report.html'}")
