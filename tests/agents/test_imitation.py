from dataclasses import replace

import numpy as np
import pytest
import torch
from plain.small_worlds import small_world

from coopmap_agents.config import ImitationSettings, PPOSettings
from coopmap_agents.pretrained import LearnedPolicy
from coopmap_agents.sb3 import make_model
from coopmap_agents.training import behavior_clone
from coopmap_agents.training.imitation import collect_demonstrations
from coopmap_baselines import make
from coopmap_env.evaluation import evaluate

NETWORK = PPOSettings(n_envs=1, rollout_steps=32, batch_size=32, hidden=(32, 32), image_features=16)
QUICK = ImitationSettings(episodes=4, rounds=2, epochs=2, batch_size=16)
LONG_ENOUGH = ImitationSettings(episodes=40, rounds=2, epochs=15, batch_size=64, learning_rate=3e-3)


def choosing():
    return small_world(action_mode="candidates", n_candidates=12, max_scans=8)


def parameters(model):
    return torch.cat([p.detach().ravel() for p in model.policy.parameters()])


def test_a_clone_of_the_rating_function_agrees_with_it_on_unseen_worlds():
    model = make_model(choosing, NETWORK, seed=0)
    model.policy.network.rating_weight.requires_grad_(False)  # 0: not even the direct path helps
    before = evaluate(choosing(), LearnedPolicy(model), range(100, 120)).table["reward"]
    report = behavior_clone(model.policy, choosing, make("rating_function"), LONG_ENOUGH, seed=0)
    print(report)
    assert report.n_held_out == 2 * 4 * 8 * 2
    assert report.n_train == 2 * 36 * 8 * 2
    assert report.agreement > 0.8
    assert model.policy.network.rating_weight == 0
    after = evaluate(choosing(), LearnedPolicy(model), range(100, 120)).table["reward"]
    planned = evaluate(choosing(), make("rating_function"), range(100, 120)).table["reward"]
    assert after.mean() - before.mean() > 0.8 * (planned.mean() - before.mean()) > 0


def test_a_network_initialised_with_the_rating_takes_a_candidate_of_the_highest_rating():
    model = make_model(choosing, replace(NETWORK, initial_policy="rating"), seed=0)
    env, rng = choosing(), np.random.default_rng(0)
    planner = make("rating_function")
    seen = collect_demonstrations(env, planner, planner, 3, rng)
    ratings = seen.observations["candidates"][..., 7].masked_fill(
        seen.observations["action_mask"] == 0, -np.inf
    )
    shown = {name: value.numpy() for name, value in seen.observations.items()}
    chosen, _ = model.policy.predict(shown, deterministic=True)
    assert len(set(chosen.tolist())) > 4
    # two candidates may have the same rating
    torch.testing.assert_close(ratings[torch.arange(len(seen)), chosen], ratings.amax(dim=1))


@pytest.mark.parametrize("make_env", [choosing, small_world])
def test_equal_seeds_give_equal_weights_and_others_other_weights(make_env):
    def cloned(seed):
        model = make_model(make_env, NETWORK, seed=0)
        torch.manual_seed(np.random.default_rng().integers(2**31))  # it draws nothing from there
        report = behavior_clone(model.policy, make_env, make("random"), QUICK, seed)
        return parameters(model), report

    (one, report), (two, again), (other, _) = cloned(0), cloned(0), cloned(1)
    assert torch.equal(one, two)
    assert report == again
    assert not torch.equal(one, other)


class ConstantPosePolicy:
    """Always takes the same pose."""

    def reset(self, rng):
        pass

    def act(self, belief, observations):
        return dict.fromkeys(observations, np.array([0.2, -0.1, 0.5], dtype=np.float32))


def test_poses_are_learned_and_their_standard_deviation_shrinks():
    model = make_model(small_world, NETWORK, seed=0)
    spread = float(model.policy.log_std.detach().mean())
    settings = replace(QUICK, episodes=20, epochs=20, learning_rate=3e-3)
    report = behavior_clone(model.policy, small_world, ConstantPosePolicy(), settings, seed=0)
    assert report.agreement == 1.0
    assert float(model.policy.log_std.detach().mean()) < spread


def test_the_critic_learns_nothing():
    model = make_model(choosing, NETWORK, seed=0)
    before = [p.detach().clone() for p in model.policy.network.value.parameters()]
    behavior_clone(model.policy, choosing, make("rating_function"), QUICK, seed=0)
    for old, new in zip(before, model.policy.network.value.parameters(), strict=True):
        assert torch.equal(old, new)


def test_the_expert_labels_the_states_of_the_behavior_policy():
    env, rng = choosing(), np.random.default_rng(0)
    expert, behavior_policy = make("rating_function"), make("random")
    alone, led = (
        collect_demonstrations(env, policy, expert, 3, rng) for policy in (expert, behavior_policy)
    )
    first = slice(0, 2)  # both robots at the start
    assert torch.equal(alone[first].observations["map"], led[first].observations["map"])
    assert torch.equal(alone[first].actions, led[first].actions)
    assert not torch.equal(alone.observations["map"], led.observations["map"])
    ratings = led.observations["candidates"][..., 7].masked_fill(
        led.observations["action_mask"] == 0, -np.inf
    )
    chosen = ratings[torch.arange(len(led)), led.actions]
    torch.testing.assert_close(chosen, ratings.amax(dim=1))


def test_the_environment_is_closed_if_the_expert_fails():
    closed = []

    def factory():
        env = choosing()
        env.close = lambda: closed.append(env)
        return env

    class Fails(ConstantPosePolicy):
        def act(self, belief, observations):
            raise OSError("no idea")

    model = make_model(choosing, NETWORK, seed=0)
    with pytest.raises(OSError, match="no idea"):
        behavior_clone(model.policy, factory, Fails(), QUICK, seed=0)
    assert len(closed) == 1


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("episodes", 1),
        ("rounds", 0),
        ("held_out_fraction", 0.0),
        ("held_out_fraction", 1.0),
        ("learning_rate", 0.0),
    ],
)
def test_invalid_settings_are_refused_with_their_value(name, value):
    with pytest.raises(ValueError, match=rf"ImitationSettings\.{name} must .*, got {value}"):
        ImitationSettings(**{name: value})
