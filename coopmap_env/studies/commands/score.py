"""The command `coopmap score`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

from tyro.conf import Positional

from coopmap_env.core.files import FileError
from coopmap_env.core.progress import log


@dataclass(frozen=True, kw_only=True)
class Score:
    """Replay submissions, compute all of their scores again, and rank them.

    Prints a line for each file. Exits with 1 and says why if a file is broken or does not replay
    bit for bit. Needs the extra report for a page.

    For example:
      coopmap score results/board/frontier.json
      coopmap score results/board --page results/board/index.html --tables results/board/tables.md
      coopmap score --no-efficiency --salt salt results/private
    """

    PURPOSE: ClassVar[str] = "benchmark families"

    files: Positional[tuple[Path, ...]]
    """Submissions, or folders with them."""
    page: Path | None = None
    """HTML page with a table for each family."""
    tables: Path | None = None
    """The tables in Markdown."""
    bounds: Path | None = None
    """Folder in which upper bounds of worlds are kept. By default one for temporary files that is
    yours alone. Those that are missing are searched: seconds to a minute for a world. Those of
    others hold, but efficiencies by them can be too low."""
    efficiency: bool = True
    """Whether to compare with the bounds."""
    replays: Path | None = None
    """Folder of yours in which finished replays are kept. So an interrupted command goes on: they
    count again as long as the record of the episode, coopmap and its libraries are the same. By
    default, everything is replayed."""
    salt: Path | None = None
    """File of the salt, for private worlds."""
    workers: int = 1
    """Episodes at a time. The results do not depend on it."""

    def extras(self) -> list[str]:
        """Extras of the page."""
        return [] if self.page is None else ["report"]

    def run(self) -> None:
        """Replay all files, print their lines, write the page."""
        from coopmap_env.studies.leaderboard import score
        from coopmap_env.studies.leaderboard.page import write_page, write_tables
        from coopmap_env.studies.leaderboard.private_worlds import read_salt
        from coopmap_env.studies.leaderboard.submission import SubmissionError
        from coopmap_env.studies.leaderboard.world_bounds import own_folder

        paths = score.expand(self.files)
        if not paths:
            raise ValueError("no files to score")
        bounds = (self.bounds or own_folder()) if self.efficiency else None
        salt = None if self.salt is None else read_salt(self.salt)
        scored: list[score.Scored] = []
        failed: dict[Path, str] = {}
        for path in paths:
            try:
                scored.append(
                    score.score_file(path, salt, bounds, self.workers, replays=self.replays)
                )
            except FileError as error:
                failed[path] = str(error)
                continue
            print(score.line(scored[-1]), flush=True)
            for note in scored[-1].notes:
                log(f"note: {path} was played with {note}, and replays here")
        if self.page is not None:
            write_page(self.page, scored, failed)
            log(f"page: {self.page}")
        if self.tables is not None:
            write_tables(self.tables, scored)
            log(f"tables: {self.tables}")
        if failed:
            raise SubmissionError("; ".join(failed.values()))
