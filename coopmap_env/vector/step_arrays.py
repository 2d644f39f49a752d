"""The arrays of a vector environment: what a step of all worlds gives, and the actions.

They are parts of one block of memory, which worker processes may share, so that no array is sent
from one process to another. The first axis is the world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import accumulate, pairwise
from math import prod
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.limits import check_bytes
from coopmap_env.vector.team_spaces import TeamSpaces

ALIGNMENT = 64
"""Bytes: each array starts a line of the processor's cache."""
NUMBERS = {bool: "?", int: "<i8", float: "<f8"}

Tree: TypeAlias = "dict[str, Any]"
"""Arrays, or their shapes and types, by name; entries may be trees."""


class ArraySpec(NamedTuple):
    """Shape and type of an array."""

    shape: tuple[int, ...]
    dtype: str


class StepArrays(NamedTuple):
    """What a step of E worlds with n robots gives; written in place."""

    observations: dict[str, NDArray[Any]]
    """Entries (E, ...) as of `TeamEnv`: those of a world's robots one after another along the axis
    after the first. With rows="agents" the state is repeated for each robot."""
    rewards: NDArray[np.float64]
    """(E, n)"""
    terminations: NDArray[np.bool_]
    """(E, n)"""
    truncations: NDArray[np.bool_]
    """(E, n)"""
    infos: dict[str, NDArray[Any]]
    """Entries (E, n)."""


class ArrayPlan(NamedTuple):
    """Shapes and types of all arrays: by them each process finds the arrays in the memory."""

    specs: Tree
    """The actions and one `StepArrays` for each buffer, as trees of `ArraySpec`."""

    @classmethod
    def make(cls, team: TeamSpaces, n_worlds: int, n_states: int, n_buffers: int) -> ArrayPlan:
        """Arrays of a team in a number of worlds; the state is repeated `n_states` times."""
        shape = n_worlds, len(team.robots)
        step = {
            "observations": {
                key: ArraySpec((n_worlds, sum(lengths), *rest), dtype)
                for key, (lengths, rest, dtype) in _concatenated(team, n_states).items()
            },
            "rewards": ArraySpec(shape, "<f8"),
            "terminations": ArraySpec(shape, "?"),
            "truncations": ArraySpec(shape, "?"),
            "infos": {key: ArraySpec(shape, NUMBERS[t]) for key, t in team.info_types.items()},
        }
        return cls(
            {
                "actions": action_spec(team, n_worlds),
                "buffers": {str(i): step for i in range(n_buffers)},
            }
        )

    @property
    def n_bytes(self) -> int:
        """Size of the memory.

        Raises
        ------
        ValueError
            If it is larger than the limit of `coopmap_env.core.limits`.
        """
        n_bytes = sum(_aligned_bytes(spec) for spec in _leaves(self.specs))
        check_bytes(n_bytes, "the memory of a vector environment (n_envs, n_robots)")
        return n_bytes

    def arrays(self, memory: Any) -> tuple[NDArray[Any], list[StepArrays]]:
        """The actions and the buffers, as views of a memory of `n_bytes`."""
        flat = np.frombuffer(memory, dtype=np.uint8)
        sizes = [_aligned_bytes(spec) for spec in _leaves(self.specs)]
        parts = iter([flat[a:b] for a, b in pairwise(accumulate(sizes, initial=0))])

        def view(spec: ArraySpec) -> NDArray[Any]:
            n_bytes = prod(spec.shape) * np.dtype(spec.dtype).itemsize
            return next(parts)[:n_bytes].view(spec.dtype).reshape(spec.shape)

        arrays = map_tree(view, self.specs)
        return arrays["actions"], [StepArrays(**own) for own in arrays["buffers"].values()]


def robot_slices(team: TeamSpaces) -> list[dict[str, slice]]:
    """Where each robot's part of each of its entries is, along the second axis."""
    slices: list[dict[str, slice]] = [{} for _ in team.robots]
    for key in team.observations[0].spaces:
        lengths = [(space[key].shape or ())[0] for space in team.observations]
        for own, (start, stop) in zip(
            slices, pairwise(accumulate(lengths, initial=0)), strict=True
        ):
            own[key] = slice(start, stop)
    return slices


def action_spec(team: TeamSpaces, n_worlds: int) -> ArraySpec:
    """The actions of all worlds: int64 (E, n) choices, or (E, k) numbers of all robots."""
    if isinstance(team.actions[0], spaces.Discrete):
        return ArraySpec((n_worlds, len(team.robots)), "<i8")
    dtype = np.dtype(team.actions[0].dtype).str
    return ArraySpec((n_worlds, sum(prod(space.shape or ()) for space in team.actions)), dtype)


def map_tree(function: Callable[..., Any], tree: Tree, *others: Tree) -> Tree:
    """Apply a function to the entries of trees of the same form."""
    return {
        key: map_tree(function, value, *(other[key] for other in others))
        if isinstance(value, dict)
        else function(value, *(other[key] for other in others))
        for key, value in tree.items()
    }


def _leaves(tree: Tree) -> Iterator[Any]:
    for value in tree.values():
        if isinstance(value, dict):
            yield from _leaves(value)
        else:
            yield value


def _concatenated(
    team: TeamSpaces, n_states: int
) -> dict[str, tuple[Sequence[int], tuple[int, ...], str]]:
    """Length of each robot's part, the further axes and the type of each observed entry."""
    entries: dict[str, Any] = {}
    for key, first in team.observations[0].spaces.items():
        shapes = [space[key].shape or () for space in team.observations]
        entries[key] = [shape[0] for shape in shapes], shapes[0][1:], np.dtype(first.dtype).str
    if team.state is not None:
        length, *rest = team.state.shape
        entries["state"] = [length] * n_states, tuple(rest), np.dtype(team.state.dtype).str
    return entries


def _aligned_bytes(spec: ArraySpec) -> int:
    n_bytes = prod(spec.shape) * np.dtype(spec.dtype).itemsize
    return -(-n_bytes // ALIGNMENT) * ALIGNMENT
