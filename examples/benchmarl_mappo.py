"""MAPPO of BenchMARL in a benchmark family, with coopmap's networks as actor and critic.

pip install "coopmap[benchmarl]"
"""

import argparse
import warnings

import torch
from benchmarl.algorithms import MappoConfig
from benchmarl.experiment import Experiment, ExperimentConfig

from coopmap_agents.benchmarl import CoopmapTask, NetworkConfig, trained_network
from coopmap_agents.pretrained import LearnedPolicy, save_policy
from coopmap_env import families
from coopmap_env.evaluation import evaluate

parser = argparse.ArgumentParser()
parser.add_argument("--frames", type=int, default=200_000, help="scans of the team")
parser.add_argument("--frames-per-batch", type=int, default=512)
parser.add_argument("--seed", type=int, default=0)
parser.add_argument("--worlds", type=int, default=40, help="validation worlds")
options = parser.parse_args()

warnings.filterwarnings("ignore", module="torch|torchrl|benchmarl")
torch.set_num_threads(1)
config = ExperimentConfig.get_from_yaml()
config.loggers, config.create_json, config.evaluation = [], False, False
config.prefer_continuous_actions = False  # choose among candidates
config.gamma, config.lr = 0.8, 3e-4
config.on_policy_collected_frames_per_batch = options.frames_per_batch
config.on_policy_n_envs_per_worker, config.on_policy_n_minibatch_iters = 8, 5
config.on_policy_minibatch_size = 128  # of the team: 256 rows of one robot
config.max_n_frames = options.frames
experiment = Experiment(
    task=CoopmapTask.CROWDED.get_task({"n_candidates": 32, "reward": "coverage"}),
    algorithm_config=MappoConfig.get_from_yaml(),
    model_config=NetworkConfig(),
    seed=options.seed,
    config=config,
)
experiment.run()
save_policy(*trained_network(experiment), "policy.safetensors")

env = families.make("crowded", split="validation", action_mode="candidates", n_candidates=32)
result = evaluate(env, LearnedPolicy("policy.safetensors"), seeds=range(options.worlds))
print(f"coverage {result.table['coverage'].mean():.1%}")
