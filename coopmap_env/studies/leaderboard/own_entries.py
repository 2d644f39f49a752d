"""The project's own entries on the leaderboard: its planners and its pretrained policies."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from coopmap_env.families import Family
from coopmap_env.studies.leaderboard.play import submit
from coopmap_env.studies.leaderboard.submission import (
    Options,
    SubmissionError,
    read_submission,
)

POSES: Options = {"action_mode": "pose", "n_candidates": 32}


def candidates(n: int) -> Options:
    """A choice among n poses: as many as the planners with ``search=n`` draw."""
    return {"action_mode": "candidates", "n_candidates": n}


class Entry(NamedTuple):
    """A policy, and how it acts."""

    policy: str
    options: Options = POSES


PLANNERS = {
    "random": Entry("random"),
    "raster": Entry("raster"),
    "rating": Entry("rating_function:search=100"),
    "rating-sequential": Entry("rating_function:search=100+coordination=sequential"),
    "information-gain": Entry("information_gain:search=100+coordination=sequential"),
    "coverage": Entry("coverage:search=300+coordination=sequential"),
    "projection": Entry("projection:coordination=sequential"),
    "frontier": Entry("frontier:coordination=sequential"),
    "frontier-nearest": Entry("frontier:utility=nearest+coordination=sequential"),
    "allocation": Entry("allocation"),
    "tour": Entry("tour"),
}
LOOKAHEAD = {
    "lookahead-one": Entry("lookahead:horizon=1"),
    "lookahead": Entry("lookahead"),
    "lookahead-joint": Entry("lookahead:coordination=joint"),
}
"""Planar: in the 3-D environment, a decision takes them 10 s and more."""
WEIGHING = {
    "lookahead-one-weighing": Entry("lookahead:horizon=1+motion_weight=0.015"),
    "lookahead-weighing": Entry("lookahead:motion_weight=0.02"),
    "predictive-weighing": Entry("predictive:motion_weight=0.015"),
    "predictive-two-weighing": Entry("predictive:horizon=2+motion_weight=0.02"),
}
"""Planners that count what motions cost, where time ends planar episodes. The weights were chosen
on training worlds of `motion-budget`."""
LEARNED = {
    "planar": {
        "learned-100": Entry("learned:model=planar-candidates", candidates(100)),
        "learned-300": Entry("learned:model=planar-candidates", candidates(300)),
        "learned-rating-100": Entry("learned:model=planar-candidates-rating", candidates(100)),
        "learned-rating-300": Entry("learned:model=planar-candidates-rating", candidates(300)),
        "learned-poses": Entry("learned:model=planar-pose"),
    },
    "field": {"learned-100": Entry("learned:model=field-candidates", candidates(100))},
}
"""By the kind of environment."""
MANY_POSES = {
    "lookahead-one-1000": Entry("lookahead:horizon=1+search=1000"),
    "lookahead-1000": Entry("lookahead:search=1000"),
    "predictive": Entry("predictive"),
    "predictive-two": Entry("predictive:horizon=2"),
}
"""Planners with 1,000 poses to choose from, on maps as they are and on predicted ones: planar."""

SURFACE = {
    "surface": Entry("surface"),
    "predictive-surface": Entry("predictive_surface"),
}
"""Planners of new surface, in the field."""


def entries_of(family: Family) -> dict[str, Entry]:
    """The entries that fit a family, by name."""
    entries = {**PLANNERS, **LEARNED[family.env_name]}
    if family.env_name != "planar":
        return entries | SURFACE
    entries |= LOOKAHEAD | MANY_POSES
    if "max_time" in family.budget:
        entries |= WEIGHING
    return entries


def is_current(path: Path, n_worlds: int) -> bool:
    """Whether a file is a submission on so many worlds of the family as it is now."""
    try:
        return read_submission(path)["n_worlds"] == n_worlds
    except SubmissionError:
        return False


def play_missing(
    family: str, entries: dict[str, Entry], folder: Path, n_worlds: int, workers: int = 1
) -> list[Path]:
    """Play the entries of a family whose submissions are missing in a folder, or not current.

    Returns
    -------
    list of Path
        The files of all entries, ``FAMILY_NAME.json.gz``.
    """
    paths = {name: folder / f"{family}_{name}.json.gz" for name in entries}
    for name, entry in entries.items():
        if not is_current(paths[name], n_worlds):
            submit(family, entry.policy, n_worlds, entry.options, paths[name], workers)
    return list(paths.values())
