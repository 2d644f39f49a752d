"""The environments: beliefs, actions, observations, rewards and the step.

Its names are what planners and wrappers of the environments need.
"""

from typing import TYPE_CHECKING

from coopmap_env.core.lazy import load_on_first_use

if TYPE_CHECKING:
    from coopmap_env.envs.actions import InvalidActionError
    from coopmap_env.envs.arguments import RewardName
    from coopmap_env.envs.belief import (
        ActionMode,
        Belief,
        CameraFrames,
        Foresight,
        Observation,
        Observations,
        Planning,
        Poses,
    )
    from coopmap_env.envs.budget import Budget
    from coopmap_env.envs.mapping_env import MappingEnv
    from coopmap_env.envs.reasons import RejectedReason
    from coopmap_env.envs.rewards import REWARD_TERMS, RewardScale, StepOutcome
    from coopmap_env.envs.step_data import Infos, InfoTypes
    from coopmap_env.envs.team import TeamEnv
else:
    __getattr__ = load_on_first_use(__name__)

__all__ = [
    "REWARD_TERMS",
    "ActionMode",
    "Belief",
    "Budget",
    "CameraFrames",
    "Foresight",
    "InfoTypes",
    "Infos",
    "InvalidActionError",
    "MappingEnv",
    "Observation",
    "Observations",
    "Planning",
    "Poses",
    "RejectedReason",
    "RewardName",
    "RewardScale",
    "StepOutcome",
    "TeamEnv",
]
