"""The command `coopmap fit-table`."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log


@dataclass(frozen=True)
class FitTable:
    """Search the camera, the world and the weights that the paper's Table 1 does not state.

    Plays training worlds only. Keeps all trials in the folder and writes record.json there: the
    best constants, and how well the table determines each. The first trial has the constants so
    far. After an interruption, the same command with --out continues; a folder with trials of other
    settings or of another version is refused. Needs the extra tuning.

    For example:
      coopmap fit-table --out results/table-fit --trials 400
    """

    PURPOSE: ClassVar[str] = "studies of the paper and of this benchmark"

    out: Path = field(default_factory=partial(new_results_path, "fit-table"))
    """Folder of the results. With that of an interrupted run, it goes on."""
    trials: int = 400
    """Trials of the search. Some five seconds each, less where one is soon behind."""
    workers: int = 1
    """Processes of the profile around the optimum. Trials follow one another."""
    printed: bool = False
    """Read Eqs. 7 and 8a as printed, as version v0 did."""

    def extras(self) -> list[str]:
        """Extras of the search."""
        return ["tuning"]

    def run(self) -> None:
        """Search, write the record, print the best constants."""
        from coopmap_env.core.locks import folder_lock
        from coopmap_env.envs.planar import PlanarSettings
        from coopmap_env.studies.section3.table_fit.record import SearchSize, fit_table

        base = PlanarSettings()
        if self.printed:
            base = replace(base, rating=PlanarSettings.v0().rating)
        with folder_lock(self.out):
            record = fit_table(self.out, SearchSize(trials=self.trials), base, self.workers, log)
        print(f"mean deviation {record['fit']['deviation']:.1%}: {record['constants']}")
        log(f"record: {self.out / 'record.json'}")
