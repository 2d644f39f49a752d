import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from plain.small_worlds import SETTINGS, masked_world, small_world
from stable_baselines3 import PPO
from vec_envs import shared

from coopmap_agents.config import PPOSettings
from coopmap_agents.networks import (
    ObservationFeatures,
    actor_parameters,
    copy_weights,
    make_network,
)
from coopmap_agents.pretrained import LearnedPolicy, resolve_network, save_policy
from coopmap_agents.sb3 import make_model, train
from coopmap_env import planar_v1
from coopmap_env.evaluation import Policy, evaluate

TINY = PPOSettings(total_steps=128, n_envs=2, rollout_steps=16, batch_size=32, n_epochs=2)


def test_a_learned_policy_is_a_policy_and_acts_on_each_robot_s_observation():
    model = train(small_world, TINY, seed=0)
    policy = LearnedPolicy(model)
    assert isinstance(policy, Policy)
    env = small_world(n_robots=2)
    observations, _ = env.reset(seed=0)
    policy.reset(np.random.default_rng(0))
    actions = policy.act(env.belief(), dict(reversed(observations.items())))
    assert list(actions) == ["robot_0", "robot_1"]
    for agent, action in actions.items():
        alone, _ = model.predict(observations[agent], deterministic=True)
        # batches of one and of two are summed in another order
        np.testing.assert_allclose(action, alone, atol=1e-6)
        assert env.action_space(agent).contains(action)


def test_a_learned_policy_on_other_observations_names_both_shapes():
    policy = LearnedPolicy(make_model(small_world, TINY, seed=0))
    env = small_world(settings=replace(SETTINGS, crop_cells=12))
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"trained on .*\(4, 8, 8\).* but got .*\(4, 12, 12\)"):
        policy.act(env.belief(), observations)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
@pytest.mark.parametrize("n_robots", [1, 2, 5])
def test_a_policy_trained_with_two_robots_acts_in_any_team(make_env, n_robots):
    policy = LearnedPolicy(make_model(make_env, TINY, seed=0))
    env = make_env(n_robots=n_robots)
    table = evaluate(env, policy, [0]).table
    assert table["coverage"][0] > 0


def test_a_policy_trained_with_one_robot_is_refused_in_teams():
    policy = LearnedPolicy(make_model(lambda: small_world(n_robots=1), TINY, seed=0))
    assert evaluate(small_world(n_robots=1), policy, [0]).table["coverage"][0] > 0
    with pytest.raises(ValueError, match=r"but got .*teammates"):
        evaluate(small_world(), policy, [0])


def test_a_learned_policy_never_takes_a_masked_candidate():
    policy = LearnedPolicy(train(masked_world, TINY, seed=0))
    evaluation = evaluate(masked_world(), policy, range(5))
    assert evaluation.table["n_rejected_actions"].sum() == 0


def test_the_error_names_the_shapes_of_training_without_the_number_of_candidates():
    policy = LearnedPolicy(make_model(masked_world, TINY, seed=0))
    env = small_world()
    observations, _ = env.reset(seed=0)
    with pytest.raises(ValueError, match=r"trained on .*candidates': \('any', 9\).* but got"):
        policy.act(env.belief(), observations)


def test_a_model_that_ignores_masks_is_refused():
    env = shared(masked_world, 1)
    extractor = {
        "features_extractor_class": ObservationFeatures,
        "features_extractor_kwargs": {"image_features": 8},
    }
    model = PPO("MultiInputPolicy", env, n_steps=8, batch_size=16, policy_kwargs=extractor)
    with pytest.raises(ValueError, match="CandidateScorer, got MultiInputActorCriticPolicy"):
        LearnedPolicy(model)


def test_the_fingerprint_depends_on_weights_and_not_on_the_process(tmp_path):
    for seed in (0, 1):
        model = make_model(small_world, TINY, seed)
        save_policy(model.policy, TINY, tmp_path / f"{seed}.safetensors")
    path = tmp_path / "0.safetensors"
    ours = LearnedPolicy(path).fingerprint
    code = (
        "from coopmap_agents.pretrained import LearnedPolicy\n"
        f"print(LearnedPolicy({str(path)!r}).fingerprint)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.strip() == ours
    assert LearnedPolicy(tmp_path / "1.safetensors").fingerprint != ours


def test_a_policy_says_how_large_it_is():
    model = make_model(small_world, TINY, seed=0)
    actor = actor_parameters(model.policy).values()
    assert LearnedPolicy(model).n_parameters == sum(values.numel() for values in actor) > 0
    assert LearnedPolicy(model).model_bytes == 4 * LearnedPolicy(model).n_parameters


def test_the_size_of_a_pretrained_policy_is_that_of_the_one_that_decides():
    policy = LearnedPolicy()
    assert policy.n_parameters is policy.model_bytes is None
    env = planar_v1.parallel_env(action_mode="candidates", max_scans=1)
    evaluate(env, policy, [0])
    assert policy.n_parameters == LearnedPolicy("planar-candidates").n_parameters


@pytest.mark.parametrize("name", ["planar-candidates", "planar-pose"])
def test_a_policy_ignores_what_is_left_if_it_was_trained_without(name):
    policy = LearnedPolicy(name)
    mode = name.split("-")[1]
    env = planar_v1.parallel_env(action_mode=mode, max_scans=3)
    observations, _ = env.reset(seed=0)
    while env.agents:
        actions = policy.act(env.belief(), observations)
        without = {agent: dict(own) for agent, own in observations.items()}
        for own in without.values():
            del own["budget"]
        as_before = policy.act(env.belief(), without)
        for agent, action in actions.items():
            np.testing.assert_array_equal(action, as_before[agent])
        observations, *_ = env.step(actions)


def test_a_policy_trained_with_what_is_left_needs_it():
    policy = LearnedPolicy(make_model(small_world, TINY, seed=0))
    env = small_world()
    observations, _ = env.reset(seed=0)
    for own in observations.values():
        del own["budget"]
    with pytest.raises(ValueError, match=r"trained on .*budget.* but got"):
        policy.act(env.belief(), observations)


@pytest.mark.parametrize("name", ["planar-candidates", "planar-pose"])
def test_a_network_that_observes_more_can_start_from_a_policy_and_acts_as_it(name):
    env = planar_v1.parallel_env(action_mode=name.split("-")[1], max_scans=3)
    spaces = env.observation_space("robot_0"), env.action_space("robot_0")
    source, target = resolve_network(name), make_network(*spaces, PPOSettings())
    copy_weights(source, target)
    observations, _ = env.reset(seed=0)
    while env.agents:
        actions = LearnedPolicy(source).act(env.belief(), observations)
        same = LearnedPolicy(target).act(env.belief(), observations)
        for agent, action in actions.items():
            # sums of more numbers, the others zeros, round differently
            np.testing.assert_allclose(same[agent], action, atol=1e-5)
        observations, *_ = env.step(actions)
