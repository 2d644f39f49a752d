"""Train a policy with PPO and evaluate it on new worlds; raise TOTAL_STEPS for a good one."""

from coopmap_agents.config import EnvConfig, PPOSettings
from coopmap_agents.ppo import train_network
from coopmap_agents.pretrained import LearnedPolicy, save_policy
from coopmap_env import planar_v1
from coopmap_env.evaluation import evaluate

TOTAL_STEPS = 512
ENVIRONMENT = {"action_mode": "candidates", "n_candidates": 16, "reward": "coverage"}

settings = PPOSettings(total_steps=TOTAL_STEPS, n_envs=2, rollout_steps=64, batch_size=64)
network = train_network(EnvConfig("planar", ENVIRONMENT), settings, seed=0)
save_policy(network, settings, "policy.safetensors")

env = planar_v1.parallel_env(split="test", **ENVIRONMENT)
result = evaluate(env, LearnedPolicy("policy.safetensors"), seeds=range(5))
print(f"coverage {result.table['coverage'].mean():.1%}")
