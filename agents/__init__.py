"""Learned policies and their training; needs the extra ``rl``.

====================  ==========================================================================
module                content
====================  ==========================================================================
``plan``,             `TrainingConfig` and its `EnvConfig`: what is trained; `PPOSettings`,
``settings``          `ImitationSettings`: how
``team_block``,       a team's environments as rows of a vectorised environment of
``workers``,          Stable-Baselines3, in this process or in workers: `SharedPolicyVecEnv`, in
``vec_env``           which all robots share one policy
``features``          `ObservationFeatures`: what the networks see of one robot's observation
``candidate_scorer``  `CandidateScorer`: scores candidates one by one, in any order and number
``pose_policy``       `PosePolicy`: a Gaussian over all poses
``networks``          `make_network`: the one or the other, for every engine
``ppo``               `train`: proximal policy optimisation on Stable-Baselines3
``rllib``             the same on Ray's RLlib (extra ``ray``); ``rllib_env`` and
                      ``rllib_network`` hand it the environments and the network
``imitation``         `clone`: learning from a planner, before PPO
``segments``,         a training as a chain of segments; `run_training`: with checkpoints,
``training``          validation and going on after an interruption; ``training_record`` is what
                      training.json says
``policy_file``       `save_policy`, `load_policy`: weights and a page of JSON, no code
``shipped``           the policies that ship in ``policies/``; ``shipping`` puts them there and
                      ``learning_curves`` draws how they were learned
``learned_policy``    `LearnedPolicy`: a trained network as a policy that the evaluation takes
``commands``          `coopmap train`
====================  ==========================================================================

This package imports none of them, so that it can be imported without torch::

    from coopmap_agents.pretrained.learned_policy import LearnedPolicy
    from coopmap_agents.sb3.ppo import train
"""

RL_EXTRA_HINT = "torch and stable-baselines3 are needed here: pip install 'coopmap[rl]'"
"""What a module says whose import fails."""
