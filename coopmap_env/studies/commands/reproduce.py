"""The command `coopmap reproduce`."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Reproduce:
    """Run Section 3 of the paper over many worlds, then the 3-D study, and write one report.

    Writes report.html, table1.csv, figure7.png, figure8.png, summary.json, field_replay.html and
    more figures into the folder, and prints Table 1 beside the paper's. After an interruption, the
    same command continues. Without the extras of the field environment, only Section 3 is run.

    For example:
      coopmap reproduce --out results/section3 --quick
      coopmap reproduce --out results/section3 --workers 2
    """

    out: Path
    """Folder of the results."""
    quick: bool = False
    """Fewer worlds: under two minutes instead of about half an hour."""
    workers: int = 1
    """Processes; the results do not depend on it."""

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
            if missing := missing_extras_hint():
                log(f"without the 3-D study, which needs: {missing}")
            else:
                field = field_study.run_field_study(episodes, field_size, self.workers, log)
            write_report(study, self.out, field)
        print(text_table_1(study))
        if field is not None:
            print(field_text_table(field))
        log(f"report: {self.out / 'report.html'}")


def missing_extras_hint() -> str:
    """Command that installs the extras of the 3-D study; empty if nothing is missing."""
    needed = {
        "field": ("pybullet", "trimesh", "embreex"),
        "octomap": ("pyoctomap",),
        "replay": ("viser",),
        "data": ("skimage",),
    }
    extras = [
        extra
        for extra, modules in needed.items()
        if any(find_spec(name) is None for name in modules)
    ]
    return f"pip install 'coopmap[{','.join(extras)}]'" if extras else ""
