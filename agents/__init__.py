"""Learned policies and their training, installed as `coopmap_agents`; needs the extra ``rl``.

Without it, trained policies act, and map networks predict, from ONNX files (extra ``onnx``).

==================  ================================================================================
module              content
==================  ================================================================================
``config``          `TrainingConfig`, `EnvConfig`, `PPOSettings`, `ImitationSettings`: what is
                    trained, and how
``architecture``    numbers of the networks' architecture; ``observations``: names of their inputs
``networks``        `make_network`: `CandidateScorer` scores candidates in any order and number,
                    `PosePolicy` is a Gaussian over poses; `ObservationFeatures` is their input
``trainer``         `make_rows`: the vector environment of a training, whose rows are robots
``ppo``             PPO as one loop, without a library: `train_network`
``sb3``             PPO on Stable-Baselines3: `train`, `SharedPolicyVecEnv`
``rllib``           PPO on Ray's RLlib (extra ``ray``)
``training``        `run_training`: a training in a folder, with validation, checkpoints and
                    resuming; `behavior_clone`: imitation of a planner before
``record``          the content of training.json
``pretrained``      `save_policy`, `load_policy`: policies as files; `LearnedPolicy`: a trained
                    network as a policy of the evaluation; `pretrained_names`: policies that ship
                    with coopmap
``map_config``      `MapTrainingConfig`: how a map network is trained
``map_prediction``  `MapPredictor`: a network that predicts the unknown part of a map;
                    `PredictivePolicy` and `PredictiveSurfacePolicy` plan on it; `run_map_training`
``model_files``     networks as files, with their weights and metadata; ``onnx``: graphs of their
                    operations, for ONNX Runtime; ``weights``: checks and fingerprints
``commands``        `coopmap train`, `coopmap train-map`
==================  ================================================================================

This package imports none of them, so it can be imported without torch::

    from coopmap_agents.ppo import train_network
    from coopmap_agents.pretrained import LearnedPolicy
"""
