"""The page of the leaderboard: one table for each family and number of worlds.

Means over other worlds are other scores: easy worlds may be among the first ones. So submissions
are ranked among those on the same worlds.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from coopmap_env import families
from coopmap_env.core.files import write_atomically
from coopmap_env.core.version import __version__
from coopmap_env.evaluation import BOOTSTRAP_SEED
from coopmap_env.evaluation.statistics import Interval, bootstrap_mean
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.leaderboard.score import Scored, model_size_texts

FINGERPRINT_DIGITS = 12
"""That are shown."""


@dataclass(frozen=True)
class Ranking:
    """The submissions to one family on the same worlds, the best first."""

    family: str
    summary: str
    private: str | None
    """Hash of the salt, if the worlds are private."""
    n_worlds: int
    score: str
    """What ranks: the efficiency of the area, or where bounds are missing the area of shown."""
    entries: tuple[Scored, ...]

    @property
    def behind(self) -> list[Interval]:
        """How far each entry is behind the first in this score: means of differences by world."""
        first, rng = self.entries[0], np.random.default_rng(BOOTSTRAP_SEED)
        pairs = [(first.by_world[self.score], entry.by_world[self.score]) for entry in self.entries]
        return [bootstrap_mean(np.subtract(*pair), rng) for pair in pairs]

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
    is_bounded = all("efficiency_auc" in one.scores for one in entries)
    score = "efficiency_auc" if is_bounded else "shown_auc"
    order = sorted(entries, key=lambda one: (-one.scores[score].estimate, str(one.path)))
    summary = families.get(family).summary
    return Ranking(family, summary, private or None, -minus_n_worlds, score, tuple(order))


def write_page(path: Path, scored: Sequence[Scored], failed: Mapping[Path, str]) -> None:
    """Write the page.

    Parameters
    ----------
    path : Path
    scored : sequence of Scored
    failed : mapping
        Files that do not replay, with the reason.

    Raises
    ------
    ImportError
        With the pip command, if Jinja is not installed.
    """
    text = render_template(
        "leaderboard/leaderboard.html",
        path.parent,
        rankings=rank(scored),
        failed=failed,
        version=__version__,
        model=model_texts,
        link=lambda file: link_from(path.parent, file),
    )
    write_atomically(path, text)


def model_texts(one: Scored) -> list[str]:
    """What is reported of a model: its size, and the first digits of its fingerprint."""
    fingerprint = one.submission["fingerprint"][:FINGERPRINT_DIGITS]
    return [*model_size_texts(one.submission), *([fingerprint] if fingerprint else [])]


def link_from(folder: Path, file: Path) -> str:
    """Address of a file, relative to the folder of a page."""
    try:
        relative = os.path.relpath(file, folder)
    except ValueError:  # another drive of Windows
        return file.resolve().as_uri()
    return quote(relative.replace(os.sep, "/"))
