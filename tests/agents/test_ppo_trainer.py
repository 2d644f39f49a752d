"""The PPO loop of our own: what it computes, what it learns, and that it repeats itself."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from plain.small_worlds import masked_world, small_world
from plain.strict_actions import Strict
from plain.toy_team import ConstantChoice, ConstantReward

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import stack
from coopmap_agents.ppo import PPOTrainer, Rollout, generalized_advantages, train_network

TINY = PPOSettings(total_steps=128, n_envs=2, rollout_steps=16, batch_size=32, n_epochs=2)
CONSTANT_REWARD = PPOSettings(
    total_steps=6144,
    n_envs=4,
    rollout_steps=32,
    batch_size=128,
    n_epochs=10,
    learning_rate=1e-2,
    gamma=0.9,
    max_gradient_norm=10.0,  # errors of a value of 10 make long gradients
    hidden=(32,),
)


def parameters(network, critic=(True, False)):
    own = dict(network.named_parameters()).items()
    return torch.cat([p.detach().ravel() for name, p in own if ("value" in name) in critic])


def test_advantages_by_hand():
    # gamma = 1/2, lambda = 1/2; row 0 goes on, row 1 ends after the second of three steps
    rewards = torch.tensor([[1.0, 1.0], [2.0, 2.0], [4.0, 4.0]])
    values = torch.tensor([[2.0, 2.0], [4.0, 4.0], [8.0, 8.0]])
    ends = torch.tensor([[False, False], [False, True], [False, False]])
    last_values = torch.tensor([16.0, 16.0])
    # deltas of row 0: 1 + 4/2 - 2 = 1, 2 + 8/2 - 4 = 2, 4 + 16/2 - 8 = 4
    # deltas of row 1: 1, 2 - 4 = -2 (nothing follows), 4
    expected = [[1 + (2 + 4 / 4) / 4, 1 - 2 / 4], [2 + 4 / 4, -2.0], [4.0, 4.0]]
    found = generalized_advantages(rewards, values, last_values, ends, 0.5, 0.5)
    assert found.tolist() == expected


def test_with_lambda_1_advantages_are_discounted_returns_less_the_values():
    generator = torch.Generator().manual_seed(0)
    rewards, values = torch.rand(2, 6, 3, generator=generator)
    last_values, ends = torch.rand(3, generator=generator), torch.rand(6, 3) < 0.3
    found = generalized_advantages(rewards, values, last_values, ends, 0.9, 1.0)
    for row in range(3):
        for t in range(6):
            total, weight = 0.0, 1.0
            for k in range(t, 6):
                total += weight * float(rewards[k, row])
                weight *= 0.0 if ends[k, row] else 0.9
            total += weight * float(last_values[row])
            assert float(found[t, row]) == pytest.approx(total - float(values[t, row]), abs=1e-5)


def test_batches_hold_every_row_once_in_another_order_each_time():
    env = small_world()
    space, actions = env.observation_space("robot_0"), env.action_space("robot_0")
    rollout = Rollout(space, actions, 4, 3, torch.device("cpu"))
    assert rollout.observations["map"].dtype == torch.uint8
    rollout.values[:] = torch.arange(12.0).reshape(4, 3)
    rollout.observations["pose"][..., 0] = rollout.values
    rollout.observations["map"][:, :, 3, 0, 1] = rollout.values.byte()
    assert rollout.observations["map"][0].is_contiguous(memory_format=torch.channels_last)
    generator = torch.Generator().manual_seed(0)
    orders = []
    for _ in range(2):
        batches = list(rollout.batches(torch.zeros(4, 3), 5, generator))
        assert [len(batch.returns) for batch in batches] == [5, 5, 2]
        orders.append(torch.cat([batch.returns for batch in batches]))
        poses = torch.cat([batch.observations["pose"][:, 0] for batch in batches])
        assert torch.equal(poses, orders[-1])
        maps = [batch.observations["map"] for batch in batches]
        assert all(own.is_contiguous(memory_format=torch.channels_last) for own in maps)
        assert torch.equal(torch.cat(maps)[:, 3, 0, 1], orders[-1].byte())
        assert sorted(orders[-1].tolist()) == list(range(12))
    assert not torch.equal(*orders)


def values_of(network, toy):
    """Values (5, 2) over one episode of the toy's two robots."""
    observations, values = toy.reset(seed=11)[0], []
    for _ in range(5):
        rows, _ = network.obs_to_tensor(stack(observations.values()))
        with torch.no_grad():
            values.append(network.predict_values(rows).numpy().ravel())
        observations, *_ = toy.step({})
    return np.array(values)


def test_the_value_of_constant_reward_1_is_1_over_1_minus_gamma_despite_truncation():
    # no clock: what is seen at the cut is also seen before, so its value is learned, not guessed
    network = train_network(partial(ConstantChoice, clock=False), CONSTANT_REWARD, seed=0)
    values = values_of(network, ConstantChoice(clock=False))
    np.testing.assert_allclose(values, 1 / (1 - 0.9), rtol=0.02)


def test_the_value_before_a_termination_is_the_discounted_sum_up_to_it():
    network = train_network(partial(ConstantReward, truncates=False), CONSTANT_REWARD, seed=0)
    expected = [sum(0.9**k for k in range(left)) for left in (5, 4, 3, 2, 1)]  # 4.10 ... 1
    values = values_of(network, ConstantReward())
    np.testing.assert_allclose(values, np.column_stack([expected] * 2), rtol=0.1)


class PaysForCandidate(ConstantChoice):
    """Pays the first feature of the chosen candidate."""

    def step(self, actions):
        paid = {robot: self.shown[robot]["candidates"][a, 0] for robot, a in actions.items()}
        observations, _, *ends = super().step(actions)
        return observations, paid, *ends

    def observe(self):
        self.shown = super().observe()
        return self.shown


def test_the_candidate_that_pays_most_is_learned():
    settings = replace(
        CONSTANT_REWARD, n_epochs=5, learning_rate=3e-3, gamma=0.0, max_gradient_norm=0.5
    )
    network = train_network(PaysForCandidate, settings, seed=0)
    env, n_best = PaysForCandidate(n_steps=200), 0
    observations, _ = env.reset(seed=5)
    for _ in range(100):
        actions, _ = network.predict(stack(observations.values()), deterministic=True)
        for own, action in zip(observations.values(), actions, strict=True):
            feature = np.where(own["action_mask"] == 1, own["candidates"][:, 0], -np.inf)
            n_best += feature[action] == feature.max()
        observations, *_ = env.step(dict(zip(observations, actions, strict=True)))
    assert n_best >= 180  # of 200


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_no_action_is_masked_or_out_of_its_space(make_env):
    settings = replace(TINY, log_std=1.0)  # most poses would be out of reach
    train_network(lambda: Strict(make_env()), settings, seed=0)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_equal_seeds_give_equal_networks_with_any_number_of_workers(make_env):
    before = torch.get_rng_state()
    one = parameters(train_network(make_env, TINY, seed=0))
    assert torch.equal(torch.get_rng_state(), before)  # the global generator is left alone
    torch.manual_seed(1)
    assert torch.equal(one, parameters(train_network(make_env, TINY, seed=0, workers=1)))
    assert not torch.equal(one, parameters(train_network(make_env, TINY, seed=1)))


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_only_the_critic_learns_during_its_warmup(make_env):
    warm = replace(TINY, total_steps=192, segment_steps=128, critic_warmup_steps=128)
    trainer = PPOTrainer(make_env, warm, seed=0)
    actor, critic = (parameters(trainer.network, kind) for kind in ([False], [True]))
    trainer.learn(0)
    assert trainer.steps == 128
    assert torch.equal(parameters(trainer.network, [False]), actor)
    assert not torch.equal(parameters(trainer.network, [True]), critic)
    trainer.learn(1)
    assert not torch.equal(parameters(trainer.network, [False]), actor)
    trainer.close()


def test_a_warm_start_is_copied_and_another_network_refused():
    warm = train_network(masked_world, TINY, seed=5)
    still = replace(TINY, learning_rate=0.0)
    copied = train_network(masked_world, still, seed=0, warm_start=warm)
    assert torch.equal(parameters(copied), parameters(warm))
    with pytest.raises(ValueError, match="initial network is not of the same settings"):
        train_network(masked_world, replace(TINY, hidden=(8,)), seed=0, warm_start=warm)


def test_returns_and_times_of_a_segment_are_reported():
    trainer = PPOTrainer(ConstantReward, TINY, seed=0)
    trainer.learn(0)
    report = trainer.report
    assert set(report.returns) == {5.0}
    assert 0 < report.environment_seconds < report.collecting_seconds < report.seconds
    trainer.close()


def test_environments_are_closed_if_the_training_fails():
    made = []

    class Breaks(ConstantReward):
        def step(self, actions):
            raise OSError("broken")

    def factory():
        made.append(Breaks())
        return made[-1]

    with pytest.raises(OSError, match="broken"):
        train_network(factory, TINY, seed=0)
    with pytest.raises(ValueError, match=r"a roll-out .* bytes"):
        train_network(factory, replace(TINY, rollout_steps=1 << 25), seed=0)
    assert [env.calls for env in made] == [["close"]] * 4


def test_threads_are_those_of_the_settings_and_put_back():
    seen, before = [], torch.get_num_threads()

    class Looks(ConstantReward):
        def step(self, actions):
            seen.append(torch.get_num_threads())
            return super().step(actions)

    train_network(Looks, replace(TINY, threads=2), seed=0)
    assert set(seen) == {2}
    assert torch.get_num_threads() == before
