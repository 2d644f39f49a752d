"""Learned policies and their training; needs the extra ``rl``.

==============  ================================================================================
module          content
==============  ================================================================================
``vec_env``     `SharedPolicyVecEnv`: a team as rows of a vectorised environment of
                Stable-Baselines3, so that all robots share one policy
``features``    `RobotFeatures`: the network's view of an observation
``masking``     `MaskedPolicy`: candidates that are masked out have probability zero
``ppo``         `PPOSettings`, `train`, `save`, `load`, and `LearnedPolicy` for `evaluate`
==============  ================================================================================

This package imports none of them, so that it can be imported without torch::

    from coopmap_agents.ppo import LearnedPolicy, PPOSettings, train
"""

NEEDS_RL = "torch and stable-baselines3 are needed here: pip install 'coopmap[rl]'"
"""What a module says whose import fails."""
