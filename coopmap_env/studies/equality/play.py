"""Play a case: vector environment, single environments, and the vector environment again."""

from __future__ import annotations

import contextlib
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.envs import MappingEnv, RejectedReason
from coopmap_env.studies.equality.actions import ActionMaker
from coopmap_env.studies.equality.cases import Case
from coopmap_env.studies.equality.shown import (
    Difference,
    DifferenceError,
    Entries,
    Shown,
    first_difference,
)
from coopmap_env.studies.equality.single_worlds import SingleWorlds
from coopmap_env.vector import MappingVectorEnv

BESIDE_SINGLE, REPLAYED = "vector beside single environments", "replayed beside first play"


@dataclass
class Counts:
    """What was met."""

    steps: int = 0
    """Of worlds."""
    robot_steps: int = 0
    """Actions of robots; those that a NextStep reset ignores are none."""
    episodes_ended: int = 0
    collisions: int = 0
    rejections: Counter[str] = field(default_factory=Counter)
    """Rejected actions by reason."""

    def add(self, entries: Entries) -> None:
        """Count the rows that were stepped."""
        if not entries:
            return
        self.robot_steps += int((entries["info n_scans"] > 0).sum())
        self.collisions += int(entries["info collided"].sum())
        reasons = map(RejectedReason, entries["info rejected_reason"].tolist())
        self.rejections.update(reason.words for reason in reasons if reason)

    def as_dict(self) -> dict[str, Any]:
        """As JSON values, the most frequent rejections first."""
        return {**vars(self), "rejections": dict(self.rejections.most_common())}

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Counts:
        """From the values of `as_dict`."""
        return cls(**{**values, "rejections": Counter(values["rejections"])})

    def __iadd__(self, other: Counts) -> Counts:
        self.steps += other.steps
        self.robot_steps += other.robot_steps
        self.episodes_ended += other.episodes_ended
        self.collisions += other.collisions
        self.rejections += other.rejections
        return self


def play_case(case: Case, n_steps: int, rng: np.random.Generator) -> Counts:
    """Play at least so many steps of worlds.

    Parameters
    ----------
    case : Case
    n_steps : int
        Rounded up to whole plays of `Case.n_steps` in each world. Only one play is in memory.
    rng : numpy.random.Generator
        Draws seeds and actions.

    Raises
    ------
    DifferenceError
        At the first difference.
    """
    counts = Counts()
    with contextlib.ExitStack() as stack:
        vector = stack.enter_context(contextlib.closing(case.vector_env()))
        single = stack.enter_context(
            contextlib.closing(
                SingleWorlds(
                    case.single_env, case.n_worlds, case.options["autoreset_mode"] == "SameStep"
                )
            )
        )
        while counts.steps < n_steps:
            seeds = rng.integers(2**31, size=case.n_worlds).tolist()
            _Play(case, vector, single, seeds, counts).run(ActionMaker(rng))
    return counts


class _Play:
    """From a reset with seeds on."""

    def __init__(
        self,
        case: Case,
        vector: MappingVectorEnv[Any],
        single: SingleWorlds,
        seeds: list[int],
        counts: Counts,
    ) -> None:
        self._case, self._vector, self._single = case, vector, single
        self._seeds, self._counts = seeds, counts

    def run(self, make_actions: ActionMaker) -> None:
        """Play beside the single environments, then again."""
        shown, actions = [self._reset()], []
        self._compare(BESIDE_SINGLE, 0, shown[0], self._single.reset(self._seeds))
        for step in range(1, self._case.n_steps + 1):
            actions.append(np.concatenate([make_actions(env) for env in self._single.envs]))
            shown.append(self._step(actions[-1]))
            self._compare(BESIDE_SINGLE, step, shown[-1], self._single.step(actions[-1]))
            self._count(shown[-1])
        maps = self._maps(self._vector.apply(map_state))
        self._compare(
            BESIDE_SINGLE, self._case.n_steps, maps, self._maps(map(map_state, self._single.envs))
        )
        self._replay(shown, actions, maps)

    def _replay(self, shown: Sequence[Shown], actions: Sequence[NDArray[Any]], maps: Shown) -> None:
        self._compare(REPLAYED, 0, self._reset(), shown[0])
        for step, own in enumerate(actions, start=1):
            self._compare(REPLAYED, step, self._step(own), shown[step])
        again = self._maps(self._vector.apply(map_state))
        self._compare(REPLAYED, len(actions), again, maps)

    def _reset(self) -> Shown:
        return Shown.of_vector(*self._vector.reset(seed=self._seeds))

    def _step(self, actions: NDArray[Any]) -> Shown:
        observations, *results, infos = self._vector.step(actions)
        return Shown.of_vector(observations, infos, tuple(results))

    def _maps(self, states: Any) -> Shown:
        """Maps by row, those of a world for each of its robots."""
        per_world = [state for state in states for _ in self._vector.robots]
        names = ("map log-odds", "map sampled", "truth")
        entries = {
            name: np.stack(own)
            for name, own in zip(names, zip(*per_world, strict=True), strict=True)
        }
        return Shown(entries, np.empty(0, dtype=int), {})

    def _count(self, shown: Shown) -> None:
        self._counts.steps += self._case.n_worlds
        self._counts.episodes_ended += int(shown.now["truncated"].sum()) // len(self._vector.robots)
        for entries in (shown.now, shown.last):
            self._counts.add(entries)

    def _compare(self, plays: str, step: int, found: Shown, expected: Shown) -> None:
        parts = [
            ("", first_difference({"rows": found.rows}, {"rows": expected.rows}), None),
            ("", first_difference(found.now, expected.now), None),
            ("last ", first_difference(found.last, expected.last), expected.rows),
        ]
        for prefix, difference, rows in parts:
            if difference is not None:
                at, entry, *values = difference
                row = at if rows is None else int(rows[at])
                world, robot = divmod(row, len(self._vector.robots))
                raise DifferenceError(
                    str(self._case),
                    Difference(
                        plays, self._seeds[world], world, step, robot, prefix + entry, *values
                    ),
                )


def map_state(env: MappingEnv[Any]) -> tuple[NDArray[Any], ...]:
    """Copies of the arrays of the team's map, and of the true cells."""
    map_ = env.belief().map
    return map_.log_odds_fixed.copy(), map_.sampled_mask.copy(), np.asarray(env.truth.occupied)
