"""PPO in one file: a policy for planar candidates, learned from a vector environment of 32 worlds.

python examples/vector_ppo.py --steps 131072 --seed 0
coopmap evaluate --action-mode candidates --policies learned:model=vector_ppo.safetensors --out out
"""

import argparse

import numpy as np
import torch

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import make_network
from coopmap_agents.pretrained import save_policy
from coopmap_env import planar_v1

N_WORLDS, ROLLOUT, BATCH, EPOCHS, GAMMA, LAMBDA, CLIP = 32, 32, 512, 2, 0.8, 0.95, 0.2

parser = argparse.ArgumentParser()
parser.add_argument("--steps", type=int, default=131_072, help="actions of robots to learn from")
parser.add_argument("--seed", type=int, default=0)
options = parser.parse_args()
torch.manual_seed(options.seed)
torch.set_num_threads(1)  # with more, sums round differently

env = planar_v1.vector_env(
    N_WORLDS, action_mode="candidates", reward="coverage", autoreset_mode="SameStep"
)
settings = PPOSettings(learning_rate=6e-4)
network = make_network(env.single_observation_space, env.single_action_space, settings)
seeds = np.random.default_rng(options.seed).integers(2**31, size=N_WORLDS)
observations, infos = env.reset(seed=seeds.tolist())

for iteration in range(-(-options.steps // (ROLLOUT * env.num_envs))):
    played, earned, coverage = [], 0.0, []
    with torch.no_grad():
        for _ in range(ROLLOUT):
            rows = {key: torch.from_numpy(own.copy()) for key, own in observations.items()}
            actions, values, log_probs = network(rows)  # masked candidates have probability 0
            observations, rewards, _, ends, infos = env.step(actions.numpy())
            earned += rewards.mean() / ROLLOUT
            paid, ends = torch.from_numpy(rewards).float(), torch.from_numpy(ends.copy())
            if ends.any():  # cut off, not over: what would follow counts
                last = {k: torch.from_numpy(own)[ends] for k, own in env.final_observations.items()}
                paid[ends] += GAMMA * network.predict_values(last)[:, 0]
                coverage += infos["final_info"]["observed_fraction"][ends].tolist()
            played.append((rows, actions, log_probs, values[:, 0], paid, ends))
        rows = {key: torch.from_numpy(own) for key, own in observations.items()}
        following, advantage, advantages = network.predict_values(rows)[:, 0], 0.0, []
        for _, _, _, values, paid, ends in reversed(played):  # generalised advantage estimation
            delta = paid + GAMMA * following * ~ends - values
            advantage = delta + GAMMA * LAMBDA * advantage * ~ends
            following = values
            advantages.insert(0, advantage)

    rows = {key: torch.cat([step[0][key] for step in played]) for key in observations}
    actions, log_probs, values = (torch.cat(own) for own in list(zip(*played, strict=True))[1:4])
    advantages = torch.cat(advantages)
    returns = advantages + values
    for _ in range(EPOCHS):
        for batch in torch.randperm(len(actions)).split(BATCH):
            own = {key: part[batch] for key, part in rows.items()}
            value, log_prob, _ = network.evaluate_actions(own, actions[batch])
            z = (advantages[batch] - advantages[batch].mean()) / (advantages[batch].std() + 1e-8)
            ratio = (log_prob - log_probs[batch]).exp()
            gain = torch.min(z * ratio, z * ratio.clamp(1 - CLIP, 1 + CLIP)).mean()
            loss = 0.5 * (value[:, 0] - returns[batch]).square().mean() - gain
            network.optimizer.zero_grad()
            loss.backward()
            torch.nn.utils.clip_grad_norm_(network.parameters(), 0.5)
            network.optimizer.step()
    steps = (iteration + 1) * len(actions)
    print(f"{steps:,} steps: reward {earned:.4f}, coverage {np.mean(coverage):.1%}", flush=True)

save_policy(network, settings, "vector_ppo.safetensors")
env.close()
