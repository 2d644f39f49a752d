"""The command `coopmap bench`."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, ClassVar, Literal

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log


@dataclass(frozen=True)
class Bench:
    """Measure steps per second, decision times and memory, and the speed of mpe2's simple_spread.

    All programs take turns in one process on one core. Each operation is repeated, in each round
    and over the rounds, and its shortest time of the processor counts, so that the figures hold on
    a busy machine too. The quartiles of ratios over the rounds say how well.

    For example:
      coopmap bench --out results/bench.json
    """

    PURPOSE: ClassVar[str] = "this machine"

    out: Path = field(default_factory=partial(new_results_path, "bench", ".json"))
    """JSON file of the results."""
    env: Literal["planar", "field", "all"] = "all"
    """Environments. "field" needs the extras field, octomap and bench."""
    rounds: int = 5
    """Rounds. More of them give shorter times on a busy machine, and better quartiles."""

    def extras(self) -> list[str]:
        """Extras of the environments that are measured."""
        of_field = [] if self.env == "planar" else ["field", "octomap"]
        return ["bench", *of_field]

    def run(self) -> None:
        """Measure, write the file, print it."""
        from coopmap_env.core.files import write_atomically
        from coopmap_env.studies.speed.field import measure_field
        from coopmap_env.studies.speed.planar import measure_planar

        if self.rounds < 1:
            raise ValueError(f"--rounds must be at least 1, got {self.rounds}")
        results: dict[str, Any] = {}
        if self.env != "field":
            results |= measure_planar(self.rounds, log)
        if self.env != "planar":
            results["field"] = measure_field(self.rounds, log)
        text = json.dumps(results, indent=2)
        write_atomically(self.out, text + "\n")
        print(text)
