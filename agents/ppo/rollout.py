"""What was played between two updates, on the network's device."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.preprocessing import is_image_space

from coopmap_env.core.limits import check_bytes


@dataclass(frozen=True)
class Batch:
    """Some rows of a roll-out, of shape (n,) and (n, ...)."""

    observations: dict[str, torch.Tensor]
    actions: torch.Tensor
    log_probs: torch.Tensor
    advantages: torch.Tensor
    returns: torch.Tensor


class Rollout:
    """Memory of T steps of R rows; observations keep their types, so that maps stay bytes.

    Parameters
    ----------
    observation_space, action_space
        Of a row.
    n_steps, n_rows : int
        T and R.
    device : torch.device

    Raises
    ------
    ValueError
        If it is larger than the limit of `coopmap_env.core.limits`.
    """

    def __init__(
        self,
        observation_space: spaces.Dict,
        action_space: spaces.Space[Any],
        n_steps: int,
        n_rows: int,
        device: torch.device,
    ) -> None:
        shape = n_steps, n_rows
        n_bytes = sum(box.low.nbytes for box in observation_space.values())  # type: ignore[attr-defined]
        check_bytes(n_steps * n_rows * n_bytes, "a roll-out (rollout_steps, n_envs, n_robots)")

        self.observations = {
            key: _empty(box, shape, device) for key, box in observation_space.spaces.items()
        }
        self.actions = _empty(action_space, shape, device)
        self.log_probs, self.values, self.rewards = torch.empty((3, *shape), device=device)
        self.ends = torch.empty(shape, dtype=torch.bool, device=device)

    def store_observations(
        self, step: int, observations: Mapping[str, NDArray[Any]]
    ) -> dict[str, torch.Tensor]:
        """Copy the observations before a step; gives the stored ones."""
        for key, values in observations.items():
            self.observations[key][step].copy_(torch.from_numpy(values))
        return {key: values[step] for key, values in self.observations.items()}

    def batches(
        self, advantages: torch.Tensor, size: int, generator: torch.Generator
    ) -> Iterator[Batch]:
        """All rows once, in random order, in batches of a size; the last one may be smaller."""
        flat = {key: values.flatten(0, 1) for key, values in self.observations.items()}
        actions, log_probs = self.actions.flatten(0, 1), self.log_probs.flatten()
        own, returns = advantages.flatten(), (advantages + self.values).flatten()
        order = torch.randperm(len(own), generator=generator).to(own.device)
        for rows in order.split(size):
            yield Batch(
                {key: _select(values, rows) for key, values in flat.items()},
                actions[rows],
                log_probs[rows],
                own[rows],
                returns[rows],
            )


def _empty(box: Any, shape: tuple[int, int], device: torch.device) -> torch.Tensor:
    """Memory of an entry of T steps of R rows; that of images has their channels last.

    So networks convolve them, and otherwise each of their passes would reorder them first.
    """
    kind = getattr(torch, box.dtype.name)
    if not is_image_space(box):
        return torch.empty((*shape, *box.shape), dtype=kind, device=device)
    channels, height, width = box.shape
    images = torch.empty((*shape, height, width, channels), dtype=kind, device=device)
    return images.movedim(-1, 2)


def _select(values: torch.Tensor, rows: torch.Tensor) -> torch.Tensor:
    """Copy of some rows, with the same order in memory."""
    if values.is_contiguous():
        return values.index_select(0, rows)
    return values.movedim(1, -1).index_select(0, rows).movedim(-1, 1)
