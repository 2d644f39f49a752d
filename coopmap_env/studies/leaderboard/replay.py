"""Episodes of a submission, played again action by action."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from coopmap_env import families
from coopmap_env.core.files import brief
from coopmap_env.envs import Belief, InvalidActionError, MappingEnv, Observation
from coopmap_env.evaluation import Episode, EpisodeRecorder, rollout
from coopmap_env.families import Family, WorldMismatchError
from coopmap_env.mapping import OccupancyMap
from coopmap_env.studies.leaderboard.submission import EpisodeRecord

HASH_DIGITS = 16
"""Hexadecimal digits of the hash of a map."""
NOT_SCORES = ("seed", "planning_time_ms")
"""Columns of `Episode.row` that are no results of the actions."""
LOGARITHMS = ("log_loss", "log_loss_free", "log_loss_occupied")
"""Scores with numpy's logarithm, whose last digits differ between processors."""
ROUNDING = 1e-12
"""Relative error that these are allowed; all other scores have to be equal."""


class ReplayError(ValueError):
    """An episode that is not what its record says; the message names the world."""


def map_hash(map_: OccupancyMap) -> str:
    """SHA-256 of the log-odds of a map, which are integers."""
    cells = np.ascontiguousarray(map_.log_odds_fixed, dtype="<i8")
    return hashlib.sha256(cells.tobytes()).hexdigest()[:HASH_DIGITS]


def scores_of(episode: Episode) -> dict[str, float | None]:
    """Scores as JSON values; None is one that is not defined."""
    row = {name: value for name, value in episode.row().items() if name not in NOT_SCORES}
    plain = {name: value if type(value) is int else float(value) for name, value in row.items()}
    return {name: value if math.isfinite(value) else None for name, value in plain.items()}


class _RecordedActions:
    """A policy that plays what is written."""

    def __init__(self, steps: list[list[int | list[float]]]) -> None:
        self._steps = steps
        self.n_played = 0

    def reset(self, rng: np.random.Generator) -> None:
        """Begin."""
        self.n_played = 0

    def act(self, belief: Belief, observations: Mapping[str, Observation]) -> dict[str, Any]:
        """The actions of the next step."""
        if self.n_played == len(self._steps):
            raise ReplayError(
                f"there are {self.n_played} steps, and the episode goes on after them"
            )
        actions = self._steps[self.n_played]
        if len(actions) != len(belief.agents):
            raise ReplayError(
                f"step {self.n_played} needs an action of each of {len(belief.agents)} robots, "
                f"got {brief(actions)}"
            )
        self.n_played += 1
        return dict(zip(belief.agents, actions, strict=True))


def replay_episode(
    env: MappingEnv[Any],
    family: Family,
    seed: int,
    record: EpisodeRecord,
    is_private: bool = False,
) -> Episode:
    """Play an episode again and compare everything with its record.

    Parameters
    ----------
    env : MappingEnv
        Of `make_env`.
    family : Family
    seed : int
        Of the world.
    record : EpisodeRecord
    is_private : bool
        Whether the world is private; other ones are compared with the frozen world.

    Returns
    -------
    Episode
        With the seed, and with a time of decisions that says nothing.

    Raises
    ------
    ReplayError
        With the world and what differs.
    """
    try:
        return _replay(env, family, seed, record, is_private)
    except (ReplayError, InvalidActionError, WorldMismatchError) as error:
        raise ReplayError(f"world {record['world']}: {error}") from error


def _replay(
    env: MappingEnv[Any],
    family: Family,
    seed: int,
    record: EpisodeRecord,
    is_private: bool,
) -> Episode:
    policy = _RecordedActions(record["actions"])
    steps = rollout(env, policy, seed)
    if not is_private:
        families.check_world(family, env, seed)
    _compare("world_hash", record["world_hash"], families.world_hash(env))
    recorder = EpisodeRecorder(env, seed)
    for step in steps:
        recorder.add(step)
    if policy.n_played != len(record["actions"]):
        raise ReplayError(
            f"there are {len(record['actions'])} steps, and the episode ends after "
            f"{policy.n_played}"
        )
    episode = recorder.episode()
    _compare_scores(record["scores"], scores_of(episode))
    _compare("map_hash", record["map_hash"], map_hash(env.belief().map))
    return episode


def _compare(name: str, stated: object, found: object) -> None:
    if stated != found:
        raise ReplayError(f"{name} {brief(stated)} is stated, and a replay gives {brief(found)}")


def _compare_scores(stated: Mapping[str, float | None], found: Mapping[str, float | None]) -> None:
    if set(stated) != set(found):
        raise ReplayError(f"the scores must be {', '.join(found)}, got {_names(stated)}")
    for name, value in found.items():
        own = stated[name]
        if (
            name in LOGARITHMS
            and value is not None
            and own is not None
            and math.isclose(own, value, rel_tol=ROUNDING)
        ):
            continue
        _compare(name, own, value)


def _names(values: Iterable[str]) -> str:
    return brief(sorted(values))
