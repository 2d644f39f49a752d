"""IPPO in skrl: a policy for each robot, which chooses among the candidates that can be taken.

pip install coopmap "skrl[torch]"
"""

import torch
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import CategoricalMixin, DeterministicMixin, Model
from skrl.multi_agents.torch.ippo import IPPO, IPPO_CFG
from skrl.trainers.torch import SequentialTrainer
from skrl.trainers.torch.sequential import SequentialTrainerCfg
from skrl.utils.spaces.torch import unflatten_tensorized_space
from torch import nn

from coopmap_env import planar_v1

ROLLOUT, STEPS = 32, 128

env = wrap_env(
    planar_v1.parallel_env(action_mode="candidates", reward="coverage"),
    wrapper="pettingzoo",
    verbose=False,
)


class Scores(Model):
    """A layer for the features of each candidate; skrl gives observations as one row of numbers."""

    def __init__(self, robot):
        own = env.observation_space(robot), env.state_space(robot), env.action_space(robot)
        Model.__init__(
            self, observation_space=own[0], state_space=own[1], action_space=own[2], device="cpu"
        )
        width = own[0]["candidates"].shape[1]
        self.body = nn.Sequential(nn.Linear(width, 32), nn.Tanh(), nn.Linear(32, 1))

    def scores(self, inputs):
        """A score of each candidate, and which of them can be taken."""
        seen = unflatten_tensorized_space(self.observation_space, inputs["observations"])
        return self.body(seen["candidates"].float())[..., 0], seen["action_mask"] == 1


class Policy(CategoricalMixin, Scores):
    """Chooses a candidate that is not masked."""

    def __init__(self, robot):
        Scores.__init__(self, robot)
        CategoricalMixin.__init__(self)

    def compute(self, inputs, role):
        """Scores as logits; a masked candidate is not chosen."""
        scores, mask = self.scores(inputs)
        return scores.masked_fill(~mask, -1e9), {}


class Value(DeterministicMixin, Scores):
    """Value of having all candidates."""

    def __init__(self, robot):
        Scores.__init__(self, robot)
        DeterministicMixin.__init__(self)

    def compute(self, inputs, role):
        """One number for each row."""
        return self.scores(inputs)[0].mean(-1, keepdim=True), {}


torch.manual_seed(0)
torch.set_num_threads(1)
robots = env.possible_agents
nothing = {robot: {} for robot in robots}  # skrl 2.1 takes an empty dict for one by robot
settings = IPPO_CFG(
    rollouts=ROLLOUT,
    discount_factor=0.9,
    time_limit_bootstrap=True,  # an episode is cut off, not over
    learning_rate_scheduler_kwargs=nothing,
    observation_preprocessor_kwargs=nothing,
    state_preprocessor_kwargs=nothing,
    value_preprocessor_kwargs=nothing,
)
settings.experiment.write_interval = settings.experiment.checkpoint_interval = 0
team = IPPO(
    possible_agents=robots,
    models={robot: {"policy": Policy(robot), "value": Value(robot)} for robot in robots},
    memories={robot: RandomMemory(memory_size=ROLLOUT, device="cpu") for robot in robots},
    observation_spaces=env.observation_spaces,
    state_spaces=env.state_spaces,
    action_spaces=env.action_spaces,
    device="cpu",
    cfg=settings,
)
trainer = SequentialTrainer(
    cfg=SequentialTrainerCfg(
        timesteps=STEPS, headless=True, disable_progressbar=True, close_environment_at_exit=False
    ),
    env=env,
    agents=team,
)
trainer.train()
env.close()
print(f"{STEPS} steps of {len(robots)} robots")
