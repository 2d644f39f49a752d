"""Spaces as JSON texts, in the form of Minari's ``metadata.json``."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
from gymnasium import spaces

from coopmap_env.core.files import brief
from coopmap_env.core.limits import check_bytes


def space_to_json(space: spaces.Space[Any]) -> str:
    """A Box, a MultiDiscrete or a Dict of them; bounds are written for each entry, as Minari does.

    Raises
    ------
    ValueError
        If it is another space.
    """
    return json.dumps(_to_values(space), separators=(",", ":"))


def _to_values(space: spaces.Space[Any]) -> dict[str, Any]:
    if isinstance(space, spaces.Dict):
        parts = {key: _to_values(part) for key, part in space.spaces.items()}
        return {"type": "Dict", "subspaces": parts}
    if isinstance(space, spaces.Box):
        return {
            "type": "Box",
            "dtype": str(space.dtype),
            "shape": list(space.shape),
            "low": space.low.tolist(),
            "high": space.high.tolist(),
        }
    if isinstance(space, spaces.MultiDiscrete):
        return {
            "type": "MultiDiscrete",
            "dtype": str(space.dtype),
            "nvec": space.nvec.tolist(),
            "start": space.start.tolist(),
        }
    raise ValueError(f"expected a Box, a MultiDiscrete or a Dict of them, got {brief(space)}")


def space_from_json(text: str) -> spaces.Space[Any]:
    """The space of a text of `space_to_json`, or of Minari.

    Raises
    ------
    ValueError
        If it is none.
    """
    try:
        return _from_values(json.loads(text))
    except (ArithmeticError, AssertionError, KeyError, RecursionError, TypeError) as error:
        raise ValueError(f"expected a space, got {brief(text)}: {error!r:.200}") from error


def _from_values(values: Any) -> spaces.Space[Any]:
    kind = values["type"]
    if kind == "Dict":
        return spaces.Dict({key: _from_values(part) for key, part in values["subspaces"].items()})
    dtype = np.dtype(str(values["dtype"]))
    if dtype.kind not in "iuf":
        raise ValueError(f"expected a space of numbers, got the type {dtype}")
    if kind == "Box":
        low, high = (np.array(values[name], dtype) for name in ("low", "high"))
        check_bytes(low.nbytes, "a space")
        return spaces.Box(low, high, tuple(values["shape"]), dtype.type)
    if kind == "MultiDiscrete":
        start = np.array(values["start"], dtype)
        return spaces.MultiDiscrete(np.array(values["nvec"], dtype), dtype.type, start=start)
    raise ValueError(f"expected a Box, a MultiDiscrete or a Dict of them, got {brief(kind)}")
