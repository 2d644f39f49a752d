"""What is played: kinds of worlds, teams, modes, and how vector environments step them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import cycle, product
from typing import Any

from coopmap_env import planar_v1
from coopmap_env.core.extras import import_optional
from coopmap_env.envs import REWARD_TERMS, MappingEnv
from coopmap_env.envs.registration import SEARCH_ARGUMENTS
from coopmap_env.simulation.scenes.planar import PLANAR_SCENES
from coopmap_env.vector import MappingVectorEnv

MODES = ("pose", "candidates")
TEAMS = (1, 2, 3, 4, 5)
"""Numbers of robots."""
RESETS = ("NextStep", "SameStep")
N_CANDIDATES = {1: 600, 2: 500, 3: 32, 4: 32, 5: 8}
"""By number of robots. The start of an episode offers less than 500: some are masked."""


@dataclass(frozen=True)
class Case:
    """Worlds of one kind, and how the vector environment steps them."""

    kind: str
    """"planar" or "field"."""
    arguments: dict[str, Any]
    """Of the environment, as JSON values."""
    options: dict[str, Any] = field(default_factory=dict)
    """Of the vector environment, likewise."""
    n_worlds: int = 3
    n_steps: int = 40
    """Steps of each world from a reset with seeds to the next."""

    def vector_env(self) -> MappingVectorEnv[Any]:
        """Make the vector environment."""
        return self._module().vector_env(self.n_worlds, **self.options, **self.arguments)

    def single_env(self) -> MappingEnv[Any]:
        """Make one of the single environments."""
        return self._module().parallel_env(**self.arguments)

    def _module(self) -> Any:
        return (
            planar_v1 if self.kind == "planar" else import_optional("coopmap_env.field_v1", "field")
        )

    def __str__(self) -> str:
        parts = {**self.arguments, **self.options}
        return f"{self.kind} " + ", ".join(f"{key}={value!r}" for key, value in parts.items())


def planar_cases() -> Iterator[Case]:
    """Every scene, mode, team, kind of reset and number of threads."""
    payments = _payments()
    for scene, mode, n_robots, reset, threads in product(
        PLANAR_SCENES, MODES, TEAMS, RESETS, (1, 2)
    ):
        choice = {"n_candidates": N_CANDIDATES[n_robots]} if mode == "candidates" else {}
        yield Case(
            "planar",
            {"scene": scene, "action_mode": mode, "n_robots": n_robots, **choice, **next(payments)},
            {"autoreset_mode": reset, "num_threads": threads, "double_buffer": threads == 2},
        )


def field_cases() -> Iterator[Case]:
    """Every scene, id, mode and team; kinds of resets and numbers of workers take turns."""
    from coopmap_env.simulation.scenes.field import FIELD_SCENES

    payments, ways = _payments(), cycle(product(RESETS, (0, 2)))
    for scene, located, mode, n_robots in product(FIELD_SCENES, (True, False), MODES, TEAMS):
        reset, workers = next(ways)
        choice = {"n_candidates": 8} if mode == "candidates" else {}
        search = {} if located else SEARCH_ARGUMENTS
        task = {"scene": scene, "action_mode": mode, "n_robots": n_robots, "max_scans": 12}
        yield Case(
            "field",
            {**task, **search, **choice, **next(payments)},
            {"autoreset_mode": reset, "num_workers": workers, "double_buffer": reset == "SameStep"},
            n_worlds=2,
            n_steps=40,
        )


def _payments() -> Iterator[dict[str, str]]:
    """Rewards in turn."""
    for reward, team_reward in cycle(product(REWARD_TERMS, ("individual", "shared"))):
        yield {"reward": reward, "team_reward": team_reward}
