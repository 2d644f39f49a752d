"""Environments of a team as rows of a batch, in this process or in workers; needs no torch."""

from coopmap_agents.rollouts.team_block import (
    BlockStep,
    EnvFactory,
    Info,
    TeamBlock,
    TeamSpaces,
    concatenate_blocks,
    stack,
)
from coopmap_agents.rollouts.workers import LocalBlock, Requests, WorkerPool

__all__ = [
    "BlockStep",
    "EnvFactory",
    "Info",
    "LocalBlock",
    "Requests",
    "TeamBlock",
    "TeamSpaces",
    "WorkerPool",
    "concatenate_blocks",
    "stack",
]
