"""Search for constants one at a time, with a record of all that was tried."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

from coopmap_env.core.settings import Settings

Constants = TypeVar("Constants", bound=Settings)


@dataclass(frozen=True)
class SearchResult(Generic[Constants]):
    """The best constants, and every choice that was tried."""

    best: Constants
    loss: float
    tried: list[dict[str, Any]]
    """By choice: its constants by name, and its ``loss``."""


def search_coordinates(
    start: Constants,
    choices: Mapping[str, Sequence[float]],
    loss: Callable[[Constants], float],
    max_rounds: int = 4,
) -> SearchResult[Constants]:
    """Vary one constant after the other over its choices; repeat while that improves the loss.

    Parameters
    ----------
    start : Settings
    choices : mapping
        By constant, the values to try; each round goes through them in this order.
    loss : callable
        To be minimised; called once for each combination of constants.
    max_rounds : int
        At most.
    """
    losses: dict[tuple[float, ...], float] = {}

    def evaluate(constants: Constants) -> float:
        key = tuple(getattr(constants, name) for name in choices)
        if key not in losses:
            losses[key] = loss(constants)
        return losses[key]

    best = start
    for _ in range(max_rounds):
        before = best
        for name, values in choices.items():
            candidates = [best, *(replace(best, **{name: value}) for value in values)]
            best = min(candidates, key=evaluate)
        if best == before:
            break
    tried = [{**dict(zip(choices, key, strict=True)), "loss": v} for key, v in losses.items()]
    return SearchResult(best, evaluate(best), tried)
