"""Checkpoints: everything that the next segment of a training depends on."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from stable_baselines3.common.policies import ActorCriticPolicy

from coopmap_env.core.files import atomic_path


def save_checkpoint(path: Path, network: ActorCriticPolicy, steps: int) -> None:
    """Write a checkpoint, atomically; it holds no code.

    Parameters
    ----------
    path : Path
    network : ActorCriticPolicy
        Its weights and those of its optimizer are written.
    steps : int
        Number of steps learned from.
    """
    states = {"network": network.state_dict(), "optimizer": network.optimizer.state_dict()}
    with atomic_path(path) as temporary:
        torch.save({"steps": steps, **states}, temporary)


def load_checkpoint(path: Path, network: ActorCriticPolicy) -> int:
    """Load a checkpoint into a network; gives the number of steps.

    Raises
    ------
    ValueError
        If the file cannot be read or is of another network.
    """
    try:
        values: dict[str, Any] = torch.load(path, map_location=network.device, weights_only=True)
    except Exception as error:  # torch raises many types of exceptions for a broken file
        raise ValueError(
            f"the checkpoint {path} cannot be read ({error}): remove its folder to start again"
        ) from error
    try:
        network.load_state_dict(values["network"])
        network.optimizer.load_state_dict(values["optimizer"])
        return int(values["steps"])
    except (RuntimeError, ValueError, KeyError) as error:
        raise ValueError(f"the checkpoint {path} is of another network: {error}") from error
