"""Which constants the table determines, as the record of the search tells."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from coopmap_env.studies.section3.table_fit.points import RANGES

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
    """Values of the profile that are surely worse, with all other coordinates kept."""
    importance: float
    """How much it decides whether a trial is among the best (PED-ANOVA); the sum of all is 1."""

    @property
    def determined(self) -> bool:
        """Whether a lower and a higher value are surely worse, with all other coordinates kept."""
        return any(v < self.best for v in self.worse) and any(v > self.best for v in self.worse)


def constant_verdicts(record: Mapping[str, Any]) -> list[ConstantVerdict]:
    """The verdict of each coordinate of a record, see `record.fit_table`."""
    verdicts = []
    for name, label in LABELS.items():
        low, high = record["near_optimal"]["ranges"][name]
        verdicts.append(
            ConstantVerdict(
                label=label,
                best=record["point"][name],
                searched=RANGES[name][:2],
                near_optimal=(low, high),
                worse=[one["value"] for one in record["profile"][name] if one["loss"]["low"] > 0],
                importance=record["importances"][name],
            )
        )
    return verdicts
