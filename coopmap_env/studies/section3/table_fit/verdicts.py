"""Which constants the table determines, and which part of it, by the record of the search.

What the search minimises has two parts: the deviation of the 18 numbers, and what the constraints
are missed by. A constant can be determined by the sum though the numbers hardly depend on it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from coopmap_env.studies.section3.table_fit.objective import Fit
from coopmap_env.studies.section3.table_fit.points import RANGES

CONSTRAINTS = {
    "observed": "the observed fraction",
    "unequal": "T1",
    "raster": "T2",
}
LABELS = {
    "field_of_view": "field of view, degrees",
    "depth_of_field": "depth of field, cells",
    "views": "area of all views over that of the world (gives its side)",
    "cost_of_5": "cost of a motion by 5 cells, nats (gives K)",
    "exponent": "n of Eq. 9",
    "heading_length": "motion that costs as much as one radian, cells",
    "n_gray_bins": "number of gray levels (Eq. 7)",
    "n_headings": "number of headings",
    "occupied_fraction": "occupied fraction",
    "block_side": "shortest side of an obstacle, cells",
    "block_ratio": "longest side of an obstacle over the shortest",
    "start_distance": "largest distance between the starts, cells",
}


@dataclass(frozen=True)
class ConstantVerdict:
    """One coordinate of the search."""

    label: str
    best: float
    searched: tuple[float, float]
    near_optimal: tuple[float, float]
    """Lowest and highest value of the trials that are almost as good as the best one."""
    worse: list[float]
    """Values of the profile with a surely larger sum, all other coordinates kept."""
    worse_numbers: list[float]
    """Those with a surely larger deviation of the 18 numbers alone."""
    missed: list[str]
    """Constraints that the values of `worse` miss, as `CONSTRAINTS` names them."""
    importance: float
    """How much it decides whether a trial is among the best (PED-ANOVA); the sum of all is 1."""

    @property
    def determined(self) -> bool:
        """Whether a lower and a higher value are surely worse, with all other coordinates kept."""
        return self._on_both_sides(self.worse)

    @property
    def determined_by(self) -> str:
        """What determines it, or "open"."""
        if self._on_both_sides(self.worse_numbers):
            return "by the 18 numbers"
        if not self.determined:
            return "open"
        return f"by {' and '.join(self.missed)}, not by the 18 numbers alone"

    def _on_both_sides(self, values: list[float]) -> bool:
        return any(v < self.best for v in values) and any(v > self.best for v in values)


def constant_verdicts(record: Mapping[str, Any]) -> list[ConstantVerdict]:
    """The verdict of each coordinate of a record, see `record.fit_table`."""
    verdicts = []
    for name, label in LABELS.items():
        low, high = record["near_optimal"]["ranges"][name]
        profile = record["profile"][name]
        worse = [one for one in profile if one["loss"]["low"] > 0]
        verdicts.append(
            ConstantVerdict(
                label=label,
                best=record["point"][name],
                searched=RANGES[name][:2],
                near_optimal=(low, high),
                worse=[one["value"] for one in worse],
                worse_numbers=[o["value"] for o in profile if o["deviation_loss"]["low"] > 0],
                missed=_missed_constraints(worse),
                importance=record["importances"][name],
            )
        )
    return verdicts


def _missed_constraints(points: Sequence[Mapping[str, Any]]) -> list[str]:
    fits = [Fit(**{name: point[name] for name in Fit.__annotations__}) for point in points]
    return [
        label for name, label in CONSTRAINTS.items() if any(fit.missed[name] > 0 for fit in fits)
    ]
