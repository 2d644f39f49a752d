"""Infos of all rows, as gymnasium's vector environments give them: arrays with masks.

Beside each entry ``key`` stands ``_key``, bool (rows,): the rows that have it.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.vector.rows import RowViews
from coopmap_env.vector.step_arrays import StepArrays


def select_infos(views: RowViews, fresh: NDArray[np.bool_]) -> dict[str, Any]:
    """Infos of the rows that were stepped or reset."""
    infos: dict[str, Any] = {}
    for key, values in views.infos.items():
        infos |= {key: values, f"_{key}": fresh}
    return infos


def all_arrays(arrays: StepArrays) -> Iterator[NDArray[Any]]:
    """All arrays of a buffer, in a fixed order."""
    yield from arrays.observations.values()
    yield from (arrays.rewards, arrays.terminations, arrays.truncations)
    yield from arrays.infos.values()
