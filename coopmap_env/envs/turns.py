"""The environments with one robot after the other, for PettingZoo's AEC API.

All robots still move and scan at once, after the last has acted: PettingZoo's conversion collects
their actions.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ParamSpec, TypeAlias

from pettingzoo import AECEnv
from pettingzoo.utils import parallel_to_aec
from pettingzoo.utils.wrappers import OrderEnforcingWrapper

from coopmap_env.envs.mapping_env import MappingEnv

Parameters = ParamSpec("Parameters")
TurnEnv: TypeAlias = "AECEnv[str, Any, Any]"
"""An environment of robots that act in turns."""


def in_turns(parallel_env: Callable[Parameters, MappingEnv[Any]]) -> Callable[Parameters, TurnEnv]:
    """What makes the same environment in turns, from the same arguments."""

    def raw_env(*args: Parameters.args, **kwargs: Parameters.kwargs) -> TurnEnv:
        """Make the environment in turns, without wrappers."""
        return parallel_to_aec(parallel_env(*args, **kwargs))

    return raw_env


def with_order(raw_env: Callable[Parameters, TurnEnv]) -> Callable[Parameters, TurnEnv]:
    """What makes the same environment with a wrapper that refuses calls in a wrong order."""

    def env(*args: Parameters.args, **kwargs: Parameters.kwargs) -> TurnEnv:
        """Make the environment in turns, with PettingZoo's check of the order of calls."""
        return OrderEnforcingWrapper(raw_env(*args, **kwargs))

    return env
