"""Learned policies and their training; needs the extra ``rl``.

====================  ==========================================================================
module                content
====================  ==========================================================================
``vec_env``           `SharedPolicyVecEnv`: a team as rows of a vectorised environment of
                      Stable-Baselines3, so that all robots share one policy
``features``          `RobotFeatures`, `SituationFeatures`: networks' views of an observation
``candidate_scorer``  `CandidateScorer`: scores candidates one by one, in any order and number
``learned_policy``    `save`, `load`, and `LearnedPolicy` for `evaluate`
``ppo``               `PPOSettings`, `make_model`, `train`; those of ``learned_policy`` as well
``imitation``         `ImitationSettings`, `clone`: learning from a planner, before PPO
====================  ==========================================================================

This package imports none of them, so that it can be imported without torch::

    from coopmap_agents.ppo import LearnedPolicy, PPOSettings, train
"""

NEEDS_RL = "torch and stable-baselines3 are needed here: pip install 'coopmap[rl]'"
"""What a module says whose import fails."""
