"""A training as a chain of segments: each depends on the weights before it and its own number.

That is what makes resuming exact: a training that was interrupted begins its segment anew, with the
same environments and the same random numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from coopmap_agents import RL_EXTRA_HINT

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.settings import PPOSettings

from coopmap_env.core.files import atomic_path


@dataclass(frozen=True)
class SegmentReport:
    """How a segment went."""

    seconds: float = 0.0
    """From its beginning to its end."""
    environment_seconds: float = 0.0
    """Of these, waiting for the environments."""
    collecting_seconds: float = 0.0
    """Of these, collecting roll-outs, the environments included: the rest are updates."""
    returns: Sequence[float] = field(default_factory=list)
    """Summed rewards of each robot in each episode that ended."""


def segment_seed(seed: int, segment: int) -> int:
    """Seed of a segment's random numbers."""
    return int(np.random.SeedSequence(seed, spawn_key=(segment,)).generate_state(1)[0])


def segment_steps(settings: PPOSettings, done: int) -> int:
    """Steps of the next segment after so many; roll-outs are not cut short."""
    return min(settings.segment_steps, settings.total_steps - done)


def save_checkpoint(path: Path, network: ActorCriticPolicy, steps: int) -> None:
    """Write all that the next segment depends on; holds no code, and is there whole or not at all.

    Parameters
    ----------
    path : Path
    network : ActorCriticPolicy
        Its weights and those of its optimizer.
    steps : int
        That it has learned from.
    """
    states = {"network": network.state_dict(), "optimizer": network.optimizer.state_dict()}
    with atomic_path(path) as temporary:
        torch.save({"steps": steps, **states}, temporary)


def load_checkpoint(path: Path, network: ActorCriticPolicy) -> int:
    """Give a network back what `save_checkpoint` wrote, and the steps.

    Raises
    ------
    ValueError
        If the file cannot be read or is of another network.
    """
    try:
        values: dict[str, Any] = torch.load(path, map_location=network.device, weights_only=True)
    except Exception as error:  # of a broken file torch raises whatever it stumbles over
        raise ValueError(
            f"the checkpoint {path} cannot be read ({error}): remove its folder to begin anew"
        ) from error
    try:
        network.load_state_dict(values["network"])
        network.optimizer.load_state_dict(values["optimizer"])
        return int(values["steps"])
    except (RuntimeError, ValueError, KeyError) as error:
        raise ValueError(f"the checkpoint {path} is of another network: {error}") from error
