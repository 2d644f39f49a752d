"""PPO in TorchRL: its own wrapper of PettingZoo, one policy for all robots, masked candidates.

pip install "coopmap[rl]" torchrl
"""

import warnings

import torch
from tensordict.nn import InteractionType, TensorDictModule
from torch import nn
from torchrl.envs.libs.pettingzoo import PettingZooWrapper
from torchrl.modules import MaskedCategorical, ProbabilisticActor
from torchrl.objectives import ClipPPOLoss
from torchrl.objectives.value import GAE

from coopmap_env import planar_v1

N_SCANS, N_EPISODES, ITERATIONS, EPOCHS, GAMMA = 8, 8, 4, 4, 0.9

warnings.filterwarnings("ignore", message="PettingZoo in TorchRL is tested using")
torch.manual_seed(0)
torch.set_num_threads(1)
env = PettingZooWrapper(
    planar_v1.parallel_env(action_mode="candidates", reward="coverage", max_scans=N_SCANS)
)
env.set_seed(0)
seen = ("robot", "observation", "candidates")  # (robots, candidates, features)
width = env.observation_spec[seen].shape[-1]


class Scores(nn.Module):
    """A score of each candidate, and the value of having them all."""

    def __init__(self):
        super().__init__()
        self.body = nn.Sequential(nn.Linear(width, 64), nn.Tanh(), nn.Linear(64, 2))

    def forward(self, candidates):
        """Scores (..., m) and a value (..., 1)."""
        scores, parts = self.body(candidates).unbind(-1)
        return scores, parts.mean(-1, keepdim=True)


actor = ProbabilisticActor(
    TensorDictModule(Scores(), [seen], [("robot", "logits"), ("robot", "unused")]),
    in_keys={"logits": ("robot", "logits"), "mask": ("robot", "action_mask")},
    out_keys=[env.action_key],
    distribution_class=MaskedCategorical,
    default_interaction_type=InteractionType.RANDOM,
    return_log_prob=True,
    log_prob_key=("robot", "log_prob"),
)
critic = TensorDictModule(Scores(), [seen], [("robot", "ignored"), ("robot", "state_value")])
loss = ClipPPOLoss(actor, critic)
loss.set_keys(
    action=env.action_key,
    sample_log_prob=("robot", "log_prob"),
    value=("robot", "state_value"),
    reward=env.reward_key,
    done=("robot", "done"),
    terminated=("robot", "terminated"),
)
advantages = GAE(gamma=GAMMA, lmbda=0.95, value_network=critic)
advantages.set_keys(
    value=("robot", "state_value"),
    reward=env.reward_key,
    done=("robot", "done"),
    terminated=("robot", "terminated"),  # none: an episode is cut off, what would follow counts
)
optimizer = torch.optim.Adam(loss.parameters(), 1e-3)
for iteration in range(ITERATIONS):
    with torch.no_grad():
        played = torch.cat([env.rollout(N_SCANS, actor) for _ in range(N_EPISODES)])
    for _ in range(EPOCHS):
        advantages(played)
        parts = loss(played)
        optimizer.zero_grad()
        sum(part for name, part in parts.items() if name.startswith("loss_")).backward()
        optimizer.step()
    observed = played["next", "robot", "info", "observed_fraction"][played["next", "done"][:, 0]]
    print(f"iteration {iteration}: coverage {observed.mean():.1%}")
env.close()
