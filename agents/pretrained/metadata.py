"""The metadata of a policy's file: from which spaces and settings its network is made."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import prod
from typing import Any

import numpy as np
from gymnasium import spaces

from coopmap_agents.config import PPOSettings
from coopmap_env.core.files import brief
from coopmap_env.core.limits import check_cells
from coopmap_env.core.settings import PositiveInt, Settings, settings_from_dict
from coopmap_env.core.version import __version__

METADATA_KEY = "coopmap"
"""Key of the JSON text in the file."""
FORMAT = 2
"""Increased when the networks, the metadata or the meaning of observations change: older files can
then no longer be read. Format 2 (0.2.0) has other keys of the metadata than format 1."""
DTYPES = ("bool", "int8", "int16", "int32", "int64", "uint8", "float16", "float32", "float64")
"""Types of the numbers of an observation."""
MAX_ENTRIES = 64
"""Entries of an observation; each takes time, however small it is."""
ARRAYS_PER_BOX = 4
"""Arrays of the size of an observation that its space holds: two bounds, and which are finite."""


@dataclass(frozen=True)
class PolicyMetadata(Settings):
    """Metadata of a policy's file.

    Raises
    ------
    ValueError
        With the field, if a value is not as described, or observations are larger than the limit of
        `coopmap_env.core.limits`.
    """

    observations: Mapping[str, Any]
    """Type and shape of each entry of the observations, such as ["float32", 4]."""
    n_candidates: PositiveInt | None
    """Number of candidates in training, in "candidates" mode."""
    action_size: PositiveInt | None
    """Length of an action, in "pose" mode."""
    ppo: Mapping[str, Any]
    """`PPOSettings` of the training."""
    training: Mapping[str, Any] = field(default_factory=dict)
    """Origin of the weights: configuration, steps and validation scores of the training."""
    version: str = __version__
    format: int = FORMAT

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("observations", "ppo", "training"):
            if not isinstance(getattr(self, name), Mapping):
                raise ValueError(f"{name} must be a JSON object, got {brief(getattr(self, name))}")
        _check_observations(self.observations)
        if (self.n_candidates is None) == (self.action_size is None):
            raise ValueError(
                "one of n_candidates and action_size must be a number and the other null, got "
                f"{self.n_candidates} and {self.action_size}"
            )
        self._check_action_size()

    def _check_action_size(self) -> None:
        if self.action_size is not None:
            check_cells([self.action_size], "the action")
            return
        for name in ("candidates", "action_mask"):
            entry = self.observations.get(name, [])
            if len(entry) < 2 or entry[1] != self.n_candidates:
                raise ValueError(
                    f"observations.{name} must be of n_candidates = {self.n_candidates}, "
                    f"got {brief(entry)}"
                )

    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shape of each entry of the observations in training."""
        return {key: tuple(entry[1:]) for key, entry in self.observations.items()}

    def spaces(self) -> tuple[spaces.Dict, spaces.Space[Any]]:
        """Spaces of the observations and of the actions."""
        actions: spaces.Space[Any]
        if self.n_candidates is not None:
            actions = spaces.Discrete(self.n_candidates)
        else:
            actions = spaces.Box(-1.0, 1.0, (self.action_size or 0,), np.float32)
        boxes: dict[str, spaces.Space[Any]] = {
            key: _box(*entry) for key, entry in self.observations.items()
        }
        return spaces.Dict(boxes), actions

    def settings(self) -> PPOSettings:
        """Settings of the network, with a critic of the local observation.

        Raises
        ------
        ValueError
            With the field, if a value is not as described.
        """
        return settings_from_dict({**self.ppo, "critic": "local", "device": "cpu"}, PPOSettings)


def _check_observations(observations: Mapping[str, Any]) -> None:
    if len(observations) > MAX_ENTRIES:
        raise ValueError(f"observations must have at most {MAX_ENTRIES} entries, not more")
    n_values = 0
    for name, entry in observations.items():
        if not isinstance(entry, list | tuple) or not entry or entry[0] not in DTYPES:
            raise ValueError(
                f"observations.{name:.80} must be a type and a shape, such as "
                f'["float32", 4], got {brief(entry)}'
            )
        sizes = entry[1:]
        if not all(type(size) is int and size > 0 for size in sizes):
            raise ValueError(
                f"observations.{name:.80} must have sizes above 0, got {brief(list(sizes))}"
            )
        n_values += prod(sizes)
    check_cells([ARRAYS_PER_BOX, n_values], "the space of a robot's observations")


def _box(dtype: str, *shape: int) -> spaces.Box:
    low, high = (0, 255) if dtype == "uint8" else (-1, 1)
    return spaces.Box(low, high, shape, np.dtype(dtype).type)
