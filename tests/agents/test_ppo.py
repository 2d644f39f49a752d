import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from plain.small_worlds import masked_world, small_world
from plain.toy_team import ConstantChoice, ConstantReward
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecMonitor
from vec_envs import shared

from coopmap_agents.config import PPOSettings
from coopmap_agents.sb3 import make_model, train

TINY = PPOSettings(total_steps=128, n_envs=2, rollout_steps=16, batch_size=32, n_epochs=2)
CONSTANT_REWARD = PPOSettings(
    total_steps=1536,
    n_envs=4,
    rollout_steps=32,
    batch_size=64,
    n_epochs=10,
    learning_rate=1e-2,
    gamma=0.5,
    max_gradient_norm=10.0,
    hidden=(32,),
)


def values_of(model, clock=True, toy=ConstantReward):
    """Values (5, 2) over one episode of the toy's two robots."""
    env = shared(lambda: toy(clock=clock), 1)
    env.seed(11)
    observations, values = env.reset(), []
    for _ in range(5):
        tensor, _ = model.policy.obs_to_tensor(observations)
        with torch.no_grad():
            values.append(model.policy.predict_values(tensor).numpy().ravel())
        observations, *_ = env.step(np.zeros((2, *env.action_space.shape), env.action_space.dtype))
    return np.array(values)


def choice(**arguments):
    return ConstantChoice(clock=False, **arguments)


def test_the_value_of_constant_reward_1_is_1_over_1_minus_gamma_despite_truncation():
    # no clock: what is seen at the cut is also seen before, so its value is learned, not guessed
    model = train(lambda: ConstantReward(clock=False), CONSTANT_REWARD, seed=0)
    np.testing.assert_allclose(values_of(model, clock=False), 1 / (1 - 0.5), rtol=0.02)


def test_among_candidates_the_value_of_constant_reward_1_is_1_over_1_minus_gamma():
    model = train(choice, CONSTANT_REWARD, seed=0)
    values = values_of(model, clock=False, toy=ConstantChoice)
    np.testing.assert_allclose(values, 1 / (1 - 0.5), rtol=0.02)


def test_the_value_before_a_termination_is_the_discounted_sum_up_to_it():
    longer = replace(CONSTANT_REWARD, total_steps=6144, gamma=0.9)
    model = train(lambda: ConstantReward(truncates=False), longer, seed=0)
    expected = [sum(0.9**k for k in range(left)) for left in (5, 4, 3, 2, 1)]  # 4.10 ... 1
    np.testing.assert_allclose(values_of(model), np.column_stack([expected] * 2), rtol=0.1)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_equal_seeds_give_equal_networks_and_others_other_networks(make_env):
    def parameters(seed):
        model = train(make_env, TINY, seed)
        return torch.cat([p.detach().ravel() for p in model.policy.parameters()])

    one = parameters(0)
    assert torch.equal(one, parameters(0))
    assert not torch.equal(one, parameters(1))


def test_training_reports_the_returns_of_robots():
    model = train(lambda: ConstantReward(), TINY, seed=0)
    assert {(episode["r"], episode["l"]) for episode in model.ep_info_buffer} == {(5.0, 5)}


def test_the_library_s_own_evaluation_takes_the_rows():
    model = train(lambda: ConstantReward(), TINY, seed=0)
    env = VecMonitor(shared(lambda: ConstantReward(), 2))
    assert evaluate_policy(model, env, n_eval_episodes=6) == (5.0, 0.0)


def parameters_of(model, critic):
    own = dict(model.policy.named_parameters())
    chosen = [p for name, p in own.items() if ("value" in name) == critic]
    return torch.cat([p.detach().ravel() for p in chosen])


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_only_the_critic_learns_during_its_warmup(make_env):
    start = make_model(make_env, TINY, seed=0)
    model = train(make_env, replace(TINY, critic_warmup_steps=128), seed=0)
    assert model.num_timesteps == 128
    assert torch.equal(parameters_of(model, critic=False), parameters_of(start, critic=False))
    assert not torch.equal(parameters_of(model, critic=True), parameters_of(start, critic=True))
    model = train(make_env, replace(TINY, total_steps=256, critic_warmup_steps=128), seed=0)
    assert model.num_timesteps == 256
    assert not torch.equal(parameters_of(model, critic=False), parameters_of(start, critic=False))


def test_a_callback_can_end_the_training_during_the_critic_s_warmup():
    settings = replace(TINY, total_steps=256, critic_warmup_steps=128)
    model = train(masked_world, settings, seed=0, callback=lambda *_: False)
    assert model.num_timesteps < 128


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_a_warm_start_copies_the_network_of_a_model(make_env):
    def parameters(network):
        return torch.cat([p.detach().ravel() for p in network.parameters()])

    warm = make_model(make_env, TINY, seed=5).policy
    before = parameters(warm).clone()
    still = replace(TINY, learning_rate=0.0)
    assert torch.equal(parameters(train(make_env, still, seed=0, warm_start=warm).policy), before)
    assert not torch.equal(
        parameters(train(make_env, TINY, seed=0, warm_start=warm).policy), before
    )
    assert torch.equal(parameters(warm), before)


def test_a_warm_start_with_another_network_is_refused_with_the_difference():
    warm = make_model(masked_world, replace(TINY, hidden=(8,)), seed=0).policy
    with pytest.raises(ValueError, match=r"network\..* has the shape \(8,\), not \(64,\)"):
        train(masked_world, TINY, seed=0, warm_start=warm)


def test_environments_are_closed_after_training_even_if_it_fails():
    made = []

    class Breaks(ConstantReward):
        def step(self, actions):
            raise OSError("broken")

    def factory():
        made.append(Breaks())
        return made[-1]

    with pytest.raises(OSError, match="broken"):
        train(factory, TINY, seed=0)
    assert [env.calls for env in made] == [["close"]] * 2


def test_unobserved_candidates_are_refused_and_environments_closed():
    made = []

    class Unseen(ConstantChoice):
        def observation_space(self, agent):
            return ConstantReward.observation_space(self, agent)

    def factory():
        made.append(Unseen())
        return made[-1]

    with pytest.raises(ValueError, match="needs observations with candidates"):
        make_model(factory, TINY, seed=0)
    assert [env.calls for env in made] == [["close"]] * 2


@pytest.mark.parametrize("missing", ["torch", "stable_baselines3"])
def test_a_missing_extra_is_named_by_the_packages_that_need_it(missing):
    code = f"""
import sys

class Missing:
    def find_spec(name, path=None, target=None):
        if name.split(".")[0] == {missing!r}:
            raise ModuleNotFoundError(name)

sys.meta_path.insert(0, Missing)
import coopmap_agents.commands, coopmap_agents.record, coopmap_env.vector  # need neither
import coopmap_agents.pretrained, coopmap_agents.map_prediction  # by ONNX Runtime, too
for module in (
    "trainer",
    "networks",
    "networks.features",
    "pretrained.torch_network",
    "map_prediction.network",
    "map_prediction.training",
    "sb3",
    "sb3.vec_env",
    "training",
    "training.checkpoints",
):
    try:
        __import__("coopmap_agents." + module)
    except ImportError as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = run.stdout.splitlines()
    assert len(lines) == 10
    assert all("pip install 'coopmap[rl]'" in line for line in lines)
