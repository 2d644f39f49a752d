"""The command `coopmap localization`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Localization:
    """Study target registration and the correction of camera poses by fiducials.

    Writes report.html, summary.json and figures into the folder. After an interruption, the same
    command continues. Needs the extras field, report and cli.

    For example:
      coopmap localization --out results/localization --quick
      coopmap localization --out results/localization --workers 2
    """

    out: Path
    """Folder of the results."""
    quick: bool = False
    """Fewer worlds: about one minute instead of ten."""
    workers: int = 1
    """Processes; the results do not depend on it, except times."""

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
