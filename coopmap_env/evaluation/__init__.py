"""Evaluation of planners and learned policies, by the same code.

``rollout`` plays an episode, ``evaluate`` plays a policy on many worlds, ``compare`` plays many
policies on the same worlds, and ``summarize`` gives their scores with confidence intervals.
"""

from typing import TYPE_CHECKING

from coopmap_env.core.lazy import load_on_first_use
from coopmap_env.evaluation.policy import Policy, check_policy, make_policy, policy_names
from coopmap_env.evaluation.rollout import Step, policy_rng, rollout

# Loaded on first use: planners import this package and need no statistics.
if TYPE_CHECKING:
    from coopmap_env.evaluation.comparison import (
        Evaluation,
        compare,
        evaluate,
        with_efficiencies,
        with_world_bounds,
        write_episodes,
    )
    from coopmap_env.evaluation.env_specs import (
        EnvSpec,
        get_env_spec,
        make_env,
        make_team_env,
        make_vector_env,
    )
    from coopmap_env.evaluation.episode import (
        Episode,
        EpisodeRecorder,
        MappedExtent,
        SurfaceResult,
        episode_from_dict,
        make_surface_evaluator,
        run_episode,
    )
    from coopmap_env.evaluation.hashes import file_hashes
    from coopmap_env.evaluation.jobs import Job, Result, ray_session, ray_workers_checked, run_jobs
    from coopmap_env.evaluation.stored_episode import is_episode
    from coopmap_env.evaluation.summary import BOOTSTRAP_SEED, summarize
else:
    __getattr__ = load_on_first_use(__name__)

__all__ = [
    "BOOTSTRAP_SEED",
    "EnvSpec",
    "Episode",
    "EpisodeRecorder",
    "Evaluation",
    "Job",
    "MappedExtent",
    "Policy",
    "Result",
    "Step",
    "SurfaceResult",
    "check_policy",
    "compare",
    "episode_from_dict",
    "evaluate",
    "file_hashes",
    "get_env_spec",
    "is_episode",
    "make_env",
    "make_policy",
    "make_surface_evaluator",
    "make_team_env",
    "make_vector_env",
    "policy_names",
    "policy_rng",
    "ray_session",
    "ray_workers_checked",
    "rollout",
    "run_episode",
    "run_jobs",
    "summarize",
    "with_efficiencies",
    "with_world_bounds",
    "write_episodes",
]
