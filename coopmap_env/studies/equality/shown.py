"""What a step shows, as arrays by name, and the first difference between two of them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Entries = dict[str, NDArray[Any]]
"""Arrays by name; the first axis is the row, a robot of a world."""


class Difference(NamedTuple):
    """Where two plays of the same seeds and actions differ."""

    plays: str
    """Which two."""
    seed: int
    """Of the world's reset."""
    world: int
    step: int
    """Steps after the reset; 0 for what the reset shows."""
    robot: int
    entry: str
    """Name, and index where it has more than one value."""
    found: str
    expected: str

    def __str__(self) -> str:
        return (
            f"{self.plays}: world {self.world} of seed {self.seed}, step {self.step}, "
            f"robot_{self.robot}, {self.entry}: {self.found}, not {self.expected}"
        )


class DifferenceError(AssertionError):
    """Two plays differ."""

    def __init__(self, case: str, difference: Difference) -> None:
        super().__init__(f"{case}: {difference}")
        self.difference = difference


class Shown(NamedTuple):
    """What a step of all worlds shows, and what those that ended in it showed last."""

    now: Entries
    rows: NDArray[np.int64]
    """Rows of `last`."""
    last: Entries
    """After a SameStep reset: the last observations and infos of the episodes that ended."""

    @classmethod
    def of_vector(
        cls,
        observations: Mapping[str, NDArray[Any]],
        infos: Mapping[str, Any],
        results: tuple[NDArray[Any], ...] | None = None,
    ) -> Shown:
        """Copies of what a vector environment gave; `results` are rewards and ends."""
        now = {f"observation {key}": values.copy() for key, values in observations.items()}
        if results is not None:
            for name, values in zip(RESULTS, results, strict=True):
                now[name] = values.copy()
        last: Entries = {}
        rows = np.flatnonzero(infos.get("_final_obs", ()))
        if len(rows):
            kept = [infos["final_obs"][row] for row in rows]
            last = {f"observation {key}": np.stack([one[key] for one in kept]) for key in kept[0]}
            last |= {key: v[rows] for key, v in _vector_infos(infos["final_info"]).items()}
            last["final_info"] = infos["_final_info"][rows]
        own = {key: value for key, value in infos.items() if "final_" not in key}
        return cls(now | _vector_infos(own), rows, last)


RESULTS = ("reward", "terminated", "truncated")


def _vector_infos(infos: Mapping[str, NDArray[Any]]) -> Entries:
    return {f"info {key}": values.copy() for key, values in infos.items()}


def stack_infos(infos: list[Mapping[str, Any]]) -> Entries:
    """Infos of single environments by row as `coopmap_env.vector` gives them: with masks."""
    entries: Entries = {}
    for key in infos[0]:
        entries[f"info {key}"] = np.array([info[key] for info in infos])
        entries[f"info _{key}"] = np.ones(len(infos), dtype=bool)
    return entries


def first_difference(found: Entries, expected: Entries) -> tuple[int, str, str, str] | None:
    """Row, entry and both values where arrays differ first; None if all have the same bytes."""
    if found.keys() != expected.keys():
        only = sorted(found.keys() ^ expected.keys())[0]
        return 0, only, *(("present", "absent") if only in found else ("absent", "present"))
    for name, values in expected.items():
        own = found[name]
        if (own.dtype, own.shape) != (values.dtype, values.shape):
            return 0, name, _kind_of(own), _kind_of(values)
        if own.tobytes() != values.tobytes():
            at = tuple(np.argwhere(_bits(own) != _bits(values))[0].tolist())
            index = f" {list(at[1:])}" if len(at) > 1 else ""
            return at[0], name + index, repr(own[at].item()), repr(values[at].item())
    return None


def _kind_of(values: NDArray[Any]) -> str:
    return f"{values.dtype} of shape {values.shape}"


def _bits(values: NDArray[Any]) -> NDArray[Any]:
    """The values, numbers as integers of the same bytes: -0 is not 0, and NaN is NaN."""
    if values.dtype.kind != "f":
        return values
    return np.ascontiguousarray(values).view(f"u{values.dtype.itemsize}")
