"""Two tests of meaning of environments in engines that take them unmodified.

Reward 1 a step, without end: the value is 1 / (1 - gamma), if engines know an end for a cut. And
where most candidates are masked, none of those is taken.
"""

import warnings

import numpy as np
import pytest
import torch
from plain.small_worlds import SETTINGS, masked_world, small_world

from coopmap_agents.networks.features import ObservationFeatures
from coopmap_env import planar_v1
from coopmap_env.envs import RejectedReason
from coopmap_env.envs.planar import PlanarEnv, PlanarTeamEnv
from coopmap_env.vector import WorkerVectorEnv

pytestmark = pytest.mark.slow

GAMMA = 0.5
FEATURES = {"features_extractor_class": ObservationFeatures}
"""Maps of these small worlds are smaller than the images that Stable-Baselines3 takes."""


class Paid(PlanarEnv):
    """Pays each robot 1 a step."""

    def _assign_rewards(self, terms):
        return dict.fromkeys(self.agents, 1.0)


class PaidTeam(PlanarTeamEnv):
    """The same for one controller."""

    parallel_env = Paid


def paid(make=Paid, **arguments):
    return make(settings=SETTINGS, max_scans=4, **arguments)


def masked_share(mask):
    return 1 - np.mean(mask)


# The plain loop: a vector environment and nothing else.


def test_plain_loop_values_a_constant_reward():
    env = WorkerVectorEnv(paid, 2, autoreset_mode="SameStep")
    env.reset(seed=0)
    value = 0.0
    for _ in range(20):
        _, rewards, terminated, *_ = env.step(np.zeros((4, 3)))
        value = float(np.mean(rewards + GAMMA * value * ~terminated))
    assert value == pytest.approx(1 / (1 - GAMMA), rel=1e-3)
    env.close()


@pytest.mark.parametrize("obeys", [True, False])
def test_plain_loop_takes_no_masked_candidate(obeys):
    arguments = {"settings": SETTINGS, "action_mode": "candidates", "n_candidates": 300}
    env = planar_v1.vector_env(2, max_scans=4, **arguments)
    rng, masked, shares = np.random.default_rng(0), 0, []
    observations, _ = env.reset(seed=0)
    for _ in range(20):
        mask = observations["action_mask"] == 1
        shares.append(masked_share(mask))
        weights = rng.random(mask.shape) * (mask if obeys else 1)
        observations, *_, infos = env.step(weights.argmax(axis=1))
        masked += int((infos["rejected_reason"] == RejectedReason.MASKED).sum())
    assert max(shares) > 0.2
    assert (masked == 0) == obeys
    env.close()


# TorchRL's wrapper of PettingZoo.


@pytest.fixture
def wrapped():
    libs = pytest.importorskip("torchrl.envs.libs.pettingzoo")
    made = []

    def make(env):
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", message="PettingZoo in TorchRL is tested using")
            made.append(libs.PettingZooWrapper(env))
        made[-1].set_seed(0)
        return made[-1]

    yield make
    for env in made:
        env.close()


def test_torchrl_values_a_constant_reward(wrapped):
    from tensordict.nn import TensorDictModule
    from torchrl.objectives.value import GAE

    class One(torch.nn.Module):
        def __init__(self):
            super().__init__()
            self.value = torch.nn.Parameter(torch.zeros(1))

        def forward(self, pose):
            return self.value.expand(*pose.shape[:-1], 1)

    env, one = wrapped(paid()), One()
    critic = TensorDictModule(one, [("robot", "observation", "pose")], [("robot", "state_value")])
    returns = GAE(gamma=GAMMA, lmbda=0.9, value_network=critic)
    returns.set_keys(
        value=("robot", "state_value"),
        value_target=("robot", "target"),
        advantage=("robot", "advantage"),
        reward=env.reward_key,
        done=("robot", "done"),
        terminated=("robot", "terminated"),
    )
    for _ in range(12):
        played = env.rollout(4)
        assert played["next", "done"][:, 0].tolist() == [False] * 3 + [True]
        returns(played)
        one.value.data = played["robot", "target"].mean().reshape(1)
    assert one.value.item() == pytest.approx(1 / (1 - GAMMA), rel=0.01)


@pytest.mark.parametrize("obeys", [True, False])
def test_torchrl_takes_no_masked_candidate(obeys, wrapped):
    from tensordict.nn import InteractionType, TensorDictModule
    from torchrl.modules import MaskedCategorical, ProbabilisticActor

    env = wrapped(masked_world())
    layer = torch.nn.Linear(9, 1)
    scores = TensorDictModule(
        lambda candidates: layer(candidates)[..., 0],
        [("robot", "observation", "candidates")],
        [("robot", "logits")],
    )
    actor = ProbabilisticActor(
        scores,
        in_keys={"logits": ("robot", "logits"), "mask": ("robot", "action_mask")}
        if obeys
        else {"logits": ("robot", "logits")},
        out_keys=[env.action_key],
        distribution_class=MaskedCategorical if obeys else torch.distributions.Categorical,
        default_interaction_type=InteractionType.RANDOM,
    )
    with torch.no_grad():
        played = torch.cat([env.rollout(4, actor) for _ in range(4)])
    assert masked_share(played["robot", "action_mask"].numpy()) > 0.1
    reasons = played["next", "robot", "info", "rejected_reason"]
    assert bool((reasons != RejectedReason.MASKED).all()) == obeys


def test_torchrl_s_random_actions_are_not_masked(wrapped):
    played = wrapped(masked_world()).rollout(4)
    assert bool((played["next", "robot", "info", "rejected_reason"] == 0).all())


def test_torchrl_checks_the_form_of_everything(wrapped):
    from torchrl.envs.utils import check_env_specs

    for mode in ("pose", "candidates"):
        check_env_specs(wrapped(small_world(action_mode=mode)))


def test_torchrl_takes_the_field(wrapped):
    pytest.importorskip("pybullet")
    from torchrl.envs.utils import check_env_specs

    from coopmap_env import field_v1

    for mode in ("pose", "candidates"):
        env = wrapped(field_v1.parallel_env(action_mode=mode, n_candidates=4, max_scans=2))
        check_env_specs(env)


# MaskablePPO on the team.


@pytest.fixture
def maskable_ppo():
    return pytest.importorskip("sb3_contrib").MaskablePPO


class Recorder:
    """Counts masked actions in the infos of a training."""

    def __init__(self):
        self.masked = self.steps = 0

    def __call__(self, local, _):
        for info in local["infos"]:
            self.steps += 1
            self.masked += int((info["rejected_reason"] == RejectedReason.MASKED).sum())
        return True


def test_maskable_ppo_takes_no_masked_candidate_of_the_team(maskable_ppo):
    arguments = {"settings": SETTINGS, "action_mode": "candidates", "n_candidates": 300}
    env = planar_v1.team_env(max_scans=4, **arguments)
    env.reset(seed=0)
    assert masked_share(env.action_masks()) > 0.2
    recorder = Recorder()
    model = maskable_ppo(
        "MultiInputPolicy", env, n_steps=32, batch_size=32, n_epochs=1, seed=0,
        policy_kwargs=FEATURES,
    )  # fmt: skip
    model.learn(64, callback=recorder)
    assert (recorder.steps, recorder.masked) == (64, 0)


def test_maskable_ppo_values_a_constant_reward_of_the_team(maskable_ppo):
    env = paid(PaidTeam, action_mode="candidates", n_candidates=4)
    model = maskable_ppo(
        "MultiInputPolicy", env, n_steps=64, batch_size=64, n_epochs=20, gamma=GAMMA,
        learning_rate=3e-3, policy_kwargs={"net_arch": [16], **FEATURES}, seed=0,
    )  # fmt: skip
    model.learn(640)
    observation, _ = env.reset(seed=1)
    tensors, _ = model.policy.obs_to_tensor(observation)
    with torch.no_grad():
        value = model.policy.predict_values(tensors).item()
    assert value == pytest.approx(2 / (1 - GAMMA), rel=0.1)  # two robots
