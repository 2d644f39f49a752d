"""Generalised advantage estimation (Schulman et al. 2016)."""

from __future__ import annotations

import torch


def generalized_advantages(
    rewards: torch.Tensor,
    values: torch.Tensor,
    last_values: torch.Tensor,
    ends: torch.Tensor,
    gamma: float,
    gae_lambda: float,
) -> torch.Tensor:
    """Advantages A_t = delta_t + gamma lambda A_{t+1}, with delta_t = r_t + gamma V_{t+1} - V_t.

    Nothing behind the end of an episode counts. Where an episode was cut short, its last reward has
    to contain gamma times the value of its last observation.

    Parameters
    ----------
    rewards, values : Tensor, shape (T, R)
        Of T steps of R rows; values of the observations before the steps.
    last_values : Tensor, shape (R,)
        Values of the observations after the last step.
    ends : Tensor of bool, shape (T, R)
        True where the step ended an episode.
    gamma, gae_lambda : float

    Returns
    -------
    Tensor, shape (T, R)
    """
    advantages = torch.empty_like(rewards)
    goes_on = (~ends).to(rewards.dtype)
    next_values, advantage = last_values, torch.zeros_like(last_values)
    for t in range(len(rewards) - 1, -1, -1):
        delta = rewards[t] + gamma * goes_on[t] * next_values - values[t]
        advantage = delta + gamma * gae_lambda * goes_on[t] * advantage
        advantages[t], next_values = advantage, values[t]
    return advantages
