"""Whether a family separates policies: the rule by which it is admitted, on training worlds."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from coopmap_env.evaluation.statistics import Interval
from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.studies.families.table import Row, Table

MOST_RANDOM, MOST_ONE_STEP, LEAST_BEYOND = 0.40, 0.75, 0.10
"""Efficiency (in the field: covered surface) that random poses and the best one-step planner may
have, and by how much one that looks ahead or knows the world has to exceed that planner."""


class Admission(NamedTuple):
    """The scores that the rule is about."""

    random: Interval
    one_step: Row
    look_ahead: Row | None
    """The best planner that looks further than the next view."""
    clairvoyant: Row | None
    compared: str

    @property
    def is_admitted(self) -> bool:
        """Whether random poses and one-step planners leave enough that others take."""
        beyond = [row.beyond for row in (self.look_ahead, self.clairvoyant) if row is not None]
        return (
            self.random.estimate <= MOST_RANDOM
            and self.one_step.scores[self.compared].estimate <= MOST_ONE_STEP
            and any(
                own is not None and own.estimate >= LEAST_BEYOND and own.low > 0 for own in beyond
            )
        )


def admission_of(table: Table) -> Admission:
    """Apply the rule to the table of a family.

    Raises
    ------
    ValueError
        If no random policy was played.
    """
    score = table.compared.score
    random = [row for row in table.rows if row.kind == "random"]
    if not random:
        raise ValueError("the rule needs a random policy")
    (one_step,) = [row for row in table.rows if row.name == table.best_one_step]
    return Admission(
        random[0].scores[score],
        one_step,
        _best(table, "look-ahead"),
        _best(table, "clairvoyant"),
        score,
    )


def _best(table: Table, kind: str) -> Row | None:
    rows = [row for row in table.rows if row.kind == kind]
    return max(rows, key=lambda row: row.scores[table.compared.score].estimate, default=None)


def admission_text(admissions: Mapping[str, Admission]) -> str:
    """The rule applied to some families, in Markdown, percent and points."""
    beyond = "beyond one step"
    rows = [
        ["family", "random", "one step", "look-ahead", beyond, "clairvoyant", beyond, "admitted"]
    ]
    for name, own in admissions.items():
        cells = [name, format_interval(own.random, 100, 1), _score_text(own, own.one_step)]
        for row in (own.look_ahead, own.clairvoyant):
            cells += [_score_text(own, row), _beyond(row)]
        cells.append("yes" if own.is_admitted else "no")
        rows.append(cells)
    return markdown_table(rows)


def _score_text(own: Admission, row: Row | None) -> str:
    if row is None:
        return ""
    return f"{format_interval(row.scores[own.compared], 100, 1)} ({row.name})"


def _beyond(row: Row | None) -> str:
    if row is None or row.beyond is None:
        return ""
    return format_interval(row.beyond, 100, 1, sign="+")
