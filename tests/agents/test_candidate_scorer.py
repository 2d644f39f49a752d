"""The scorer of candidates depends neither on their order nor on their number."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium import spaces
from plain.small_worlds import small_world
from scorers import logits, other_sizes, played_rows, sampled_rows, scorer_of
from vec_envs import shared

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import CandidateScorer
from coopmap_agents.networks.candidate_scorer import RATING_FEATURE_INDEX
from coopmap_agents.pretrained import LearnedPolicy
from coopmap_agents.sb3 import make_model
from coopmap_baselines import make
from coopmap_env import field_v1

SMALL = PPOSettings(n_envs=1, rollout_steps=32, batch_size=32)
CLOSE = {"rtol": 1e-4, "atol": 1e-4}
"""Sums over candidates and teammates are rounded to float32, in another order."""


def team_world(m=20, n_robots=3, **arguments):
    return small_world(
        action_mode="candidates", n_candidates=m, n_robots=n_robots, max_scans=8, **arguments
    )


def field_world(m=6, n_robots=3, **arguments):
    pytest.importorskip("pybullet")
    settings = field_v1.FieldSettings(crop_cells=(8, 4))
    return field_v1.parallel_env(
        action_mode="candidates", n_candidates=m, n_robots=n_robots, settings=settings, **arguments
    )


def search_world():
    return field_world(initialization="search")


class Spaces:
    """Just the spaces of an environment's first robot."""

    def __init__(self, env):
        self.observation_space = env.observation_space("robot_0")
        self.action_space = env.action_space("robot_0")
        env.close()


WORLDS = pytest.mark.parametrize("make_env", [team_world, field_world, search_world])


@WORLDS
def test_permuted_candidates_have_permuted_logits_and_the_same_value(make_env):
    env = Spaces(make_env())
    policy, rows = scorer_of(env), sampled_rows(env.observation_space)
    order = torch.randperm(env.action_space.n, generator=torch.Generator().manual_seed(0))
    permuted = rows | {key: rows[key][:, order] for key in ("candidates", "action_mask")}
    torch.testing.assert_close(logits(policy, permuted), logits(policy, rows)[:, order], **CLOSE)
    torch.testing.assert_close(
        policy.predict_values(permuted), policy.predict_values(rows), **CLOSE
    )
    assert logits(policy, rows).std(dim=1).min() > 0.01  # or nothing would be tested


@WORLDS
def test_the_order_of_teammates_changes_nothing(make_env):
    env = Spaces(make_env())
    policy, rows = scorer_of(env), sampled_rows(env.observation_space)
    swapped = rows | {"teammates": rows["teammates"].flip(1)}
    if "located" in rows:  # the own flag comes first
        swapped["located"] = torch.cat([rows["located"][:, :1], rows["located"][:, 1:].flip(1)], 1)
    torch.testing.assert_close(logits(policy, swapped), logits(policy, rows), **CLOSE)
    torch.testing.assert_close(policy.predict_values(swapped), policy.predict_values(rows), **CLOSE)


@pytest.mark.parametrize(
    ("make_env", "part"),
    [
        *((team_world, part) for part in ("map", "pose", "teammates", "candidates")),
        *((field_world, part) for part in ("map", "joints", "camera", "teammates", "candidates")),
        (search_world, "located"),
    ],
)
def test_scores_and_values_depend_on_every_entry_of_the_observation(make_env, part):
    env = Spaces(make_env())
    policy, rows = scorer_of(env), sampled_rows(env.observation_space)
    other = rows | {part: sampled_rows(env.observation_space, seed=1)[part]}
    assert (logits(policy, other) - logits(policy, rows)).abs().max() > 1e-3
    assert (policy.predict_values(other) - policy.predict_values(rows)).abs().max() > 1e-3


def test_features_of_masked_candidates_have_no_effect():
    env = Spaces(team_world())
    policy, rows = scorer_of(env), sampled_rows(env.observation_space)
    offered = rows["action_mask"] == 1
    other = rows | {"candidates": torch.where(offered[..., None], rows["candidates"], 9.0)}
    one, two = (policy.get_distribution(given).distribution.probs for given in (rows, other))
    torch.testing.assert_close(one, two)
    torch.testing.assert_close(policy.predict_values(other), policy.predict_values(rows))


@WORLDS
def test_the_parameters_do_not_depend_on_the_numbers_of_candidates_and_teammates(make_env):
    env = Spaces(make_env())
    shapes = {key: value.shape for key, value in scorer_of(env).state_dict().items()}
    m, n = env.action_space.n, env.observation_space["teammates"].shape[0]
    env.observation_space = other_sizes(env.observation_space, 10 * m, 2 * n)
    env.action_space = spaces.Discrete(10 * m)
    assert {key: value.shape for key, value in scorer_of(env).state_dict().items()} == shapes


def test_with_all_but_m_masked_the_logits_are_those_of_m_candidates():
    env = Spaces(team_world(m=20))
    policy, rows = scorer_of(env), sampled_rows(env.observation_space)
    rows["action_mask"][:] = 1
    many = rows | {
        "candidates": torch.cat([rows["candidates"], torch.zeros(4, 280, 9)], dim=1),
        "action_mask": torch.cat([rows["action_mask"], torch.zeros(4, 280, dtype=torch.int8)], 1),
    }
    torch.testing.assert_close(logits(policy, many)[:, :20], logits(policy, rows), **CLOSE)
    torch.testing.assert_close(policy.predict_values(many), policy.predict_values(rows), **CLOSE)


@pytest.mark.parametrize("m", [1, 7, 300])
@pytest.mark.parametrize("n_robots", [1, 2, 4])
def test_a_policy_of_32_candidates_and_3_robots_decides_among_any_number(m, n_robots):
    learned = LearnedPolicy(make_model(lambda: team_world(32), SMALL, seed=0))
    env = team_world(m, n_robots)
    observations, _ = env.reset(seed=0)
    for _ in range(3):
        actions = learned.act(env.belief(), observations)
        for agent, action in actions.items():
            assert env.action_space(agent).contains(action)
            assert observations[agent]["action_mask"][action] == 1
        observations, *_ = env.step(actions)


def test_a_single_robot_needs_no_teammates():
    env, rows = played_rows(lambda: team_world(n_robots=1))
    assert "teammates" not in rows
    assert logits(scorer_of(env), rows).shape == (2, 20)


@pytest.mark.parametrize("side", [4, 13, 64])
def test_maps_may_have_any_size(side):
    env = Spaces(team_world())
    image = spaces.Box(0, 255, (5, side, side), np.uint8)
    env.observation_space = spaces.Dict({**env.observation_space.spaces, "map": image})
    assert logits(scorer_of(env), sampled_rows(env.observation_space)).shape == (4, 20)


def same_as_the_planner(env, seeds):
    """Decisions of a network initialised with the rating, and those equal to the planner's."""
    model = make_model(lambda: env, replace(SMALL, initial_policy="rating"), seed=0)
    hand_set, planner = LearnedPolicy(model), make("rating_function")
    rng, n, same = np.random.default_rng(0), 0, 0
    for seed in seeds:
        observations, _ = env.reset(seed=seed)
        while env.agents:
            ours = hand_set.act(env.belief(), observations)
            theirs = planner.act(env.belief(), observations)
            for agent, index in ours.items():
                rating = observations[agent]["candidates"][:, RATING_FEATURE_INDEX]
                n += 1
                same += index == theirs[agent] or rating[index] == rating[theirs[agent]]
            random = {
                agent: rng.choice(np.flatnonzero(observations[agent]["action_mask"]))
                for agent in env.agents
            }
            observations, *_ = env.step(random)
    return n, same


def test_initialised_with_the_rating_it_decides_as_the_rating_function():
    n, same = same_as_the_planner(team_world(n_robots=2), range(40))
    assert n == same == 40 * 8 * 2


def test_initialised_with_the_rating_it_decides_so_in_the_field_environment():
    n, same = same_as_the_planner(field_world(n_robots=2, max_scans=3), range(1))
    assert n == same == 6


def test_initialised_with_the_rating_all_layers_have_gradients():
    env, rows = played_rows(team_world)
    policy = scorer_of(env, initial_policy="rating")
    for _ in range(3):  # the gradient reaches the last layer first, which is zero
        values, log_prob, _ = policy.evaluate_actions(rows, torch.zeros(len(rows["pose"])))
        policy.optimizer.zero_grad()
        (values.sum() - log_prob.sum()).backward()
        policy.optimizer.step()
    gradients = {name: p.grad for name, p in policy.named_parameters()}
    assert [name for name, g in gradients.items() if g is None or not g.any()] == []


def test_a_policy_is_saved_with_its_constructor_arguments(tmp_path):
    env, rows = played_rows(team_world)
    policy = scorer_of(env, initial_policy="rating")
    policy.save(tmp_path / "policy.pt")
    again = CandidateScorer.load(tmp_path / "policy.pt")
    assert again.initial_policy == "rating"
    torch.testing.assert_close(logits(again, rows), logits(policy, rows), rtol=0, atol=0)


def test_observations_without_candidates_are_refused():
    env = shared(small_world, 1)
    with pytest.raises(ValueError, match="needs observations with candidates"):
        scorer_of(env)


@pytest.mark.parametrize("options", [{"initial_policy": "best"}, {"net_arch": []}])
def test_invalid_options_are_refused(options):
    env = Spaces(team_world())
    with pytest.raises(ValueError, match=r"got ('best'|\[\])"):
        CandidateScorer(env.observation_space, env.action_space, lambda _: 1e-3, **options)
