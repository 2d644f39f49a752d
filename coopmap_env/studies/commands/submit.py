"""The command `coopmap submit`."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from coopmap_env.core.progress import log
from coopmap_env.envs.arguments import ActionModeName


@dataclass(frozen=True, kw_only=True)
class Submit:
    """Play a policy on the test worlds of a benchmark family and write a submission.

    The file has all actions and scores; `coopmap score` replays it. After an interruption, the same
    command continues. Needs the extra cli, and the extra field for families of field worlds.

    For example:
      coopmap submit --family crowded --policy frontier --out results/board/frontier.json
      coopmap submit --family crowded --policy learned --action-mode candidates --out results/l.json
      coopmap submit --family crowded --policy raster --salt salt --out results/private/raster.json
    """

    family: str
    """Name of the family; see coopmap_env.families."""
    policy: str
    """Name with options: name:key=value+key=value."""
    out: Path
    """The file, packed with gzip if the name ends in .gz. Finished episodes are kept in the folder
    of the same name that ends in .episodes, which can be removed afterwards."""
    episodes: int = 200
    """Worlds, from the first one on."""
    action_mode: ActionModeName = "pose"
    """Any pose, or a choice among random feasible poses."""
    n_candidates: int = 32
    """Number of candidates, in "candidates" mode."""
    salt: Path | None = None
    """File with at least 16 random bytes, for private worlds: those that nobody else can make."""
    workers: int = 1
    """Episodes at a time; only the times of decisions depend on it."""

    def run(self) -> None:
        """Play all episodes and write the file."""
        from coopmap_env.studies.leaderboard.play import submit
        from coopmap_env.studies.leaderboard.private_worlds import read_salt
        from coopmap_env.studies.leaderboard.submission import Options

        options: Options = {"action_mode": self.action_mode, "n_candidates": self.n_candidates}
        salt = None if self.salt is None else read_salt(self.salt)
        submit(self.family, self.policy, self.episodes, options, self.out, self.workers, salt)
        log(f"submission: {self.out}; coopmap score {self.out} replays it")
