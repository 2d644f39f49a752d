"""The command `coopmap report`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from tyro.conf import Positional

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log


@dataclass(frozen=True, kw_only=True)
class Report:
    """Compare saved runs of `coopmap evaluate`: a table with 95 % intervals and a figure.

    Writes report.md and figure.png (score against scans, decision time and motion; extra report)
    into the folder, and prints the table. Nothing is played again.

    Such as:
      coopmap report results/mine
      coopmap report results/mine results/others --out results/both
    """

    PURPOSE: ClassVar[str] = "play and compare policies"

    runs: Positional[tuple[Path, ...]]
    """Folders of runs."""
    out: Path = field(default_factory=partial(new_results_path, "report"))
    """Folder of the report."""

    def run(self) -> None:
        """Read the runs, write the report, print its table."""
        if not self.runs:
            raise ValueError("name the folder of at least one run, which coopmap evaluate wrote")
        if self.out.is_file():
            raise ValueError(f"--out {self.out} is a file: the report is a folder")
        from coopmap_env.evaluation.report import (
            differences,
            join_runs,
            missing_figure_text,
            table_lines,
            write_report,
        )
        from coopmap_env.evaluation.saved_run import load_run

        runs = {str(folder): load_run(folder) for folder in self.runs}
        joined, notes = join_runs(runs), differences(runs)
        write_report(joined, self.out, f"{', '.join(runs)}", notes)
        print("\n".join(table_lines(joined)))
        for note in notes:
            log(f"note: {note}")
        if missing := missing_figure_text():
            log(missing)
