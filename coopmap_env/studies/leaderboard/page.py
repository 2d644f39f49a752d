"""The leaderboard as a page of HTML, and its tables in Markdown."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from coopmap_env.core.files import write_atomically
from coopmap_env.core.version import __version__
from coopmap_env.evaluation.tables import format_interval, markdown_table
from coopmap_env.studies.common.pages import render_template
from coopmap_env.studies.leaderboard.ranking import Ranking, rank
from coopmap_env.studies.leaderboard.score import Scored, model_size_texts

FINGERPRINT_DIGITS = 12
"""That are shown."""
INTRODUCTION = """Policies on the test worlds of the benchmark families. `coopmap score` replayed
every submission and computed every score again. Means over the worlds with 95 % bootstrap
intervals. "Behind" is the mean of the differences to the first of the table, world by world."""


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


def write_tables(path: Path, scored: Sequence[Scored]) -> None:
    """Write the tables in Markdown."""
    parts = ["# Leaderboard", INTRODUCTION, *map(_markdown, rank(scored))]
    write_atomically(path, "\n\n".join(parts) + "\n")


def _markdown(ranking: Ranking) -> str:
    first, *others = (column.title for column in ranking.columns)
    titles = ["", "policy", "acts by", first, "behind, points", *others, "decision, ms (reported)"]
    rows = [titles]
    for k, (one, behind) in enumerate(zip(ranking.entries, ranking.behind, strict=True)):
        scores = [
            format_interval(one.scores[score], scale, 1) if score in one.scores else "-"
            for _, score, scale in ranking.columns
        ]
        scores.insert(1, format_interval(behind, 100, 1) if k else "")
        policy, ms = one.submission["policy"], one.submission["reported"]["decision_ms"]
        rows.append([str(k + 1), f"`{policy}`", one.mode, *scores, f"{ms:.3g}"])
    return f"## {ranking.title}\n\n{ranking.text}\n\n{markdown_table(rows)}"


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
