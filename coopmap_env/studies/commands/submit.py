"""The command `coopmap submit`."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log
from coopmap_env.envs.arguments import ActionModeName
from coopmap_env.envs.registration import family_env_name


@dataclass(frozen=True, kw_only=True)
class Submit:
    """Play a policy on the test worlds of a benchmark family and write a submission.

    The file has all actions and scores; `coopmap score` replays it. After an interruption, the same
    command with --out continues. Needs the extra field for families of field worlds.

    For example:
      coopmap submit --family crowded --policy frontier --out results/board/frontier.json
      coopmap submit --family crowded --policy learned --action-mode candidates --out results/l.json
      coopmap submit --family crowded --policy raster --salt salt --out results/private/raster.json
    """

    family: str
    """Name of the family. See coopmap_env.families."""
    policy: str
    """Name with options: name:key=value+key=value."""
    PURPOSE: ClassVar[str] = "benchmark families"

    out: Path = field(default_factory=partial(new_results_path, "submit", ".json"))
    """The file, packed with gzip if its name ends in .gz. Finished episodes are kept in the folder
    of the same name that ends in .episodes, which can be removed afterwards."""
    episodes: int = 200
    """Worlds, from the first one on."""
    action_mode: ActionModeName = "pose"
    """Any pose, or a choice among random feasible poses."""
    n_candidates: int = 32
    """Number of candidates, in "candidates" mode."""
    salt: Path | None = None
    """File with at least 16 random bytes, for private worlds. Nobody else can make them."""
    workers: int = 1
    """Episodes at a time. Only the times of decisions depend on it."""

    def extras(self) -> list[str]:
        """Extras of the family."""
        return ["field"] if family_env_name(self.family) == "field" else []

    def run(self) -> None:
        """Play all episodes and write the file."""
        from coopmap_env.evaluation import check_policy

        check_policy(self.policy)
        from coopmap_env.studies.leaderboard.play import submit
        from coopmap_env.studies.leaderboard.private_worlds import read_salt
        from coopmap_env.studies.leaderboard.submission import Options

        options: Options = {"action_mode": self.action_mode, "n_candidates": self.n_candidates}
        salt = None if self.salt is None else read_salt(self.salt)
        submit(self.family, self.policy, self.episodes, options, self.out, self.workers, salt)
        log(f"coopmap score {self.out} replays it")
