"""Times that hold on a busy machine: minima of operations over repeats, in interleaved rounds.

Other programs lengthen an operation, they never shorten it. So each operation is repeated, and the
shortest time counts; times are those of the processor, not of a clock on the wall. All programs
take turns in each repeat, so that what disturbs one disturbs the others too.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from coopmap_env.studies.speed.cases import Run, Timings


@dataclass(frozen=True)
class Case:
    """One of the programs that take turns.

    Attributes
    ----------
    run : Run
        Does all operations once, and returns their times.
    repeats : int
        Runs in each round.
    """

    run: Run
    repeats: int = 5


@dataclass(frozen=True)
class Total:
    """Seconds of some operations together."""

    seconds: float
    """Each operation at its shortest in all rounds."""
    of_rounds: NDArray[np.float64]
    """Each at its shortest in a round, (rounds,)."""


@dataclass(frozen=True)
class Measured:
    """Times of a case."""

    minima: dict[str, NDArray[np.float64]]
    """By kind of operation (rounds, operations): each operation at its shortest in a round."""

    def shortest(self, kind: str) -> NDArray[np.float64]:
        """Seconds of each operation of a kind, (operations,)."""
        return np.asarray(self.minima[kind].min(axis=0))

    def total(self, *kinds: str) -> Total:
        """All operations of these kinds."""
        return Total(
            float(sum(self.shortest(kind).sum() for kind in kinds)),
            np.sum([self.minima[kind].sum(axis=1) for kind in kinds], axis=0),
        )


@dataclass(frozen=True)
class Ratio:
    """How many times longer one thing takes than another."""

    estimate: float
    """Of the shortest times."""
    quartiles: tuple[float, float]
    """Of the rounds: how far the estimate can be trusted on this machine now."""

    def __str__(self) -> str:
        low, high = self.quartiles
        return f"{self.estimate:.3f} (quartiles of the rounds {low:.3f}, {high:.3f})"


def ratio(slow: Total, fast: Total, scale: float = 1.0) -> Ratio:
    """Time of `slow` over that of `fast`, times `scale`: where they do not do equally much."""
    low, high = scale * np.percentile(slow.of_rounds / fast.of_rounds, [25.0, 75.0])
    return Ratio(scale * slow.seconds / fast.seconds, (float(low), float(high)))


def measure(cases: Mapping[str, Case], rounds: int) -> dict[str, Measured]:
    """Run all cases in turn; in each round as often as a case asks for.

    Raises
    ------
    ValueError
        If a case does not do the same number of operations each time.
    """
    played = [_play_round(cases) for _ in range(rounds)]
    return {name: _minima(name, [runs[name] for runs in played]) for name in cases}


def _play_round(cases: Mapping[str, Case]) -> dict[str, list[Timings]]:
    """Timings of all runs of a round; every second turn goes backwards."""
    runs: dict[str, list[Timings]] = {name: [] for name in cases}
    for repeat in range(max(case.repeats for case in cases.values())):
        turn = list(cases.items())
        for name, case in turn if repeat % 2 == 0 else reversed(turn):
            if repeat < case.repeats:
                runs[name].append(case.run())
    return runs


def _minima(name: str, rounds: list[list[Timings]]) -> Measured:
    minima = {}
    for kind in rounds[0][0]:
        lengths = {len(run[kind]) for runs in rounds for run in runs}
        if len(lengths) > 1:
            raise ValueError(f"{name} must do the same operations in each run, got {lengths}")
        minima[kind] = np.array([[run[kind] for run in runs] for runs in rounds]).min(axis=1)
    return Measured(minima)
