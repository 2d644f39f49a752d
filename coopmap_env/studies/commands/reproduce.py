"""The command `coopmap reproduce`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.extras import missing_extras, pip_command
from coopmap_env.core.progress import log

EXTRAS_OF_THE_FIELD = ("field", "octomap", "replay")


@dataclass(frozen=True)
class Reproduce:
    """Run Section 3 of the paper over many worlds, then the 3-D study, and write one report.

    Writes report.html, table1.csv, figure7.png, figure8.png, summary.json, field_replay.html and
    more figures into the folder, and prints Table 1 beside the paper's. After an interruption, the
    same command with --out continues. Without the extras field, octomap and replay, only Section 3
    is run.

    For example:
      coopmap reproduce --out results/section3 --quick
      coopmap reproduce --out results/section3 --workers 2
    """

    PURPOSE: ClassVar[str] = "studies of the paper and of this benchmark"

    out: Path = field(default_factory=partial(new_results_path, "reproduce"))
    """Folder of the results. With that of an interrupted run, it goes on."""
    quick: bool = False
    """Fewer worlds. They take under two minutes instead of about half an hour."""
    workers: int = 1
    """Processes. The results do not depend on it."""

    def extras(self) -> list[str]:
        """Extras of the recorded log and the report."""
        return ["data", "report"]

    def run(self) -> None:
        """Run the study, write its files, print the table."""
        from coopmap_env.core.locks import folder_lock
        from coopmap_env.studies.field import study as field_study
        from coopmap_env.studies.field.report import field_text_table
        from coopmap_env.studies.section3 import study as section3
        from coopmap_env.studies.section3.report import text_table_1, write_report

        size = section3.QUICK if self.quick else section3.FULL
        field_size = field_study.QUICK if self.quick else field_study.FULL
        episodes = self.out / "episodes"
        with folder_lock(self.out):
            study = section3.run_section3(episodes, size, self.workers, log)
            field = None
            if missing := missing_extras(EXTRAS_OF_THE_FIELD):
                log(f"without the 3-D study, which needs: {pip_command(missing)}")
            else:
                field = field_study.run_field_study(episodes, field_size, self.workers, log)
            write_report(study, self.out, field)
        print(text_table_1(study))
        if field is not None:
            print(field_text_table(field))
        log(f"report: {self.out / 'report.html'}")
