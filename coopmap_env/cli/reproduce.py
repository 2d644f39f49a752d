"""The command `coopmap reproduce`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coopmap_env.cli.output import say


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
        study = section3.run(self.out / "episodes", size, self.workers, say)
        report.write_report(study, self.out)
        print(report.text_table_1(study))
        say(f"report: {self.out / 'report.html'}")
