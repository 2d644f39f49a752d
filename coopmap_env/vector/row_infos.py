"""Infos of all rows, as gymnasium's vector environments give them: arrays with masks.

Beside each entry ``key`` stands ``_key``, bool (rows,): the rows that have it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.vector.rows import Rows, RowViews
from coopmap_env.vector.step_arrays import StepArrays
from coopmap_env.vector.team_spaces import TeamSpaces


def select_infos(
    rows: Rows, views: RowViews, fresh: NDArray[np.bool_], stepped: NDArray[np.bool_]
) -> dict[str, Any]:
    """Infos of the rows that were stepped or reset; entries of a step only where stepped."""
    infos: dict[str, Any] = {}
    for key in rows.team.reset_infos:
        infos |= _with_mask(key, views.infos[key], fresh)
    if "action_mask" in views.observations:
        shape = (len(fresh), len(rows.team.robots), -1) if rows.of == "teams" else (len(fresh), -1)
        infos |= _with_mask("action_mask", views.observations["action_mask"].reshape(shape), fresh)
    if stepped.any():
        for key in _step_only(rows.team):
            infos |= _with_mask(key, views.infos[key], stepped)
    return infos


def step_info_arrays(team: TeamSpaces, arrays: StepArrays) -> Iterator[NDArray[Any]]:
    """Arrays of the infos that there are only after a step."""
    for key in _step_only(team):
        yield from _arrays(arrays.infos[key])


def all_arrays(arrays: StepArrays) -> Iterator[NDArray[Any]]:
    """All arrays of a buffer, in a fixed order."""
    yield from arrays.observations.values()
    yield from (arrays.rewards, arrays.terminations, arrays.truncations)
    yield from _arrays(arrays.infos)


def _step_only(team: TeamSpaces) -> list[str]:
    return [key for key in team.step_infos if key not in team.reset_infos]


def _with_mask(key: str, value: Any, mask: NDArray[np.bool_]) -> dict[str, Any]:
    if isinstance(value, dict):
        parts: dict[str, Any] = {}
        for name, own in value.items():
            parts |= _with_mask(name, own, mask)
        value = parts
    return {key: value, f"_{key}": mask}


def _arrays(tree: Any) -> Iterator[NDArray[Any]]:
    if isinstance(tree, dict):
        for value in tree.values():
            yield from _arrays(value)
    else:
        yield tree
