"""The tables of the leaderboard: one for each family and number of worlds.

Means over other worlds are other scores: easy worlds may be among the first ones. So submissions
are ranked among those on the same worlds.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coopmap_env import families
from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import Interval, bootstrap_mean
from coopmap_env.studies.leaderboard.score import Scored

RANKING_TEXTS = {
    "efficiency_auc": "Ranked by the efficiency of the area.",
    "shown_auc": "Ranked by the area under the curve of what was shown, as bounds are not known "
    "for all entries.",
    "surface_coverage_auc": "Ranked by the area under the curve of the covered surface.",
}
"""By the score that ranks."""


class Column(NamedTuple):
    """A column of scores."""

    title: str
    score: str
    scale: float = 100.0


SHOWN_COLUMNS = (Column("shown, %", "shown"), Column("shown area, %", "shown_auc"))
MOTION_COLUMN = Column("motion (Eq. 5)", "motion_distance", 1.0)
PLANAR_COLUMNS = (
    Column("efficiency, area, %", "efficiency_auc"),
    Column("efficiency, end, %", "efficiency"),
    *SHOWN_COLUMNS,
    Column("coverage area, %", "coverage_auc"),
    MOTION_COLUMN,
)
FIELD_COLUMNS = (
    Column("surface area, %", "surface_coverage_auc"),
    Column("surface, end, %", "surface_coverage"),
    *SHOWN_COLUMNS,
    Column("F-score, %", "f_score"),
    MOTION_COLUMN,
)


@dataclass(frozen=True)
class Ranking:
    """The submissions to one family on the same worlds, the best first."""

    family: str
    summary: str
    private: str | None
    """Hash of the salt, if the worlds are private."""
    n_worlds: int
    score: str
    """What ranks: the efficiency of the area, where bounds are missing the area of shown, in the
    field the area of the covered surface."""
    entries: tuple[Scored, ...]

    @property
    def behind(self) -> list[Interval]:
        """How far each entry is behind the first in this score: means of differences by world."""
        first, rng = self.entries[0], np.random.default_rng(BOOTSTRAP_SEED)
        pairs = [(first.by_world[self.score], entry.by_world[self.score]) for entry in self.entries]
        return [bootstrap_mean(np.subtract(*pair), rng) for pair in pairs]

    @property
    def columns(self) -> tuple[Column, ...]:
        """Columns of scores."""
        return FIELD_COLUMNS if self.score == "surface_coverage_auc" else PLANAR_COLUMNS

    @property
    def title(self) -> str:
        """Family and worlds, in words."""
        worlds = f"private worlds of the salt {self.private}" if self.private else "worlds"
        return f"{self.family}, {self.n_worlds} {worlds}"

    @property
    def text(self) -> str:
        """What the family is, and what ranks."""
        return f"{self.summary} {RANKING_TEXTS[self.score]}"

    @property
    def machines(self) -> dict[str, list[str]]:
        """What was reported of machines and versions, and the files with it."""
        found: dict[str, list[str]] = {}
        for entry in self.entries:
            reported = entry.submission["reported"]
            items = {**reported["machine"], **reported["versions"]}
            text = ", ".join(f"{name} {value}" for name, value in items.items())
            found.setdefault(text, []).append(entry.path.name)
        return found


def rank(scored: Sequence[Scored]) -> list[Ranking]:
    """Sort submissions into tables of the same worlds, and by score within them.

    Of a family, public worlds come before private ones, and more worlds before fewer.
    """
    groups: dict[tuple[str, str, int], list[Scored]] = {}
    for one in scored:
        submission = one.submission
        key = (submission["family"], submission["private"] or "", -submission["n_worlds"])
        groups.setdefault(key, []).append(one)
    return [_ranking(*key, groups[key]) for key in sorted(groups)]


def _ranking(family: str, private: str, minus_n_worlds: int, entries: list[Scored]) -> Ranking:
    has = [name for name in RANKING_TEXTS if all(name in one.scores for one in entries)]
    score = "surface_coverage_auc" if "surface_coverage_auc" in has else has[0]
    order = sorted(entries, key=lambda one: (-one.scores[score].estimate, str(one.path)))
    summary = families.get(family).summary
    return Ranking(family, summary, private or None, -minus_n_worlds, score, tuple(order))
