"""Training by RLlib: the same problem, networks and files as with Stable-Baselines3."""

import math
import os
import signal
import subprocess
import sys
import traceback
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from plain.small_worlds import masked_world, small_world
from plain.strict_actions import Strict
from plain.toy_team import ConstantChoice, ConstantReward, StatefulEnv
from ray.rllib.core import DEFAULT_MODULE_ID
from ray.rllib.core.columns import Columns

from coopmap_agents.config import EnvConfig, PPOSettings, TrainingConfig
from coopmap_agents.networks import copy_weights, stack
from coopmap_agents.pretrained import LearnedPolicy
from coopmap_agents.rllib import RLlibTrainer, make_config
from coopmap_agents.rllib.env import shared_spaces, suppress_rllib_warnings
from coopmap_agents.rllib.network import shared_network_spec
from coopmap_agents.sb3 import SB3Trainer
from coopmap_agents.training import load_checkpoint, run_training, save_checkpoint
from coopmap_env.core.processes import WorkerError
from coopmap_env.evaluation import ray_session

TINY = PPOSettings(
    total_steps=256, segment_steps=128, n_envs=4, rollout_steps=16, batch_size=64, n_epochs=2,
    hidden=(16,), image_features=8,
)  # fmt: skip
CONSTANT_REWARD = PPOSettings(
    total_steps=1024, segment_steps=1024, n_envs=4, rollout_steps=32, batch_size=64, n_epochs=10,
    learning_rate=1e-2, gamma=0.5, max_gradient_norm=10.0, hidden=(32,),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def ray(tmp_path_factory):
    """Two processors for the workers of this file."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("ray"))  # workers import from here too: no sources
        for folder in Path(__file__).parents[:2]:  # workers import this file and its toys
            patch.setenv("PYTHONPATH", str(folder), prepend=os.pathsep)
        with ray_session(workers=2) as started:
            yield started


@pytest.fixture
def train():
    """Trainings that are closed at the end of a test."""
    opened = []

    def begin(env_factory, settings=TINY, seed=0, workers=0, segments=0):
        opened.append(RLlibTrainer(env_factory, settings, seed, workers))
        for segment in range(segments):
            opened[-1].learn(segment)
        return opened[-1]

    yield begin
    for training in opened:
        training.close()


def parameters(network, critic=(True, False)):
    own = dict(network.named_parameters()).items()
    return torch.cat([p.detach().ravel() for name, p in own if ("value" in name) in critic])


def values_of(network, toy):
    """Values (5, 2) over one episode of the toy's two robots."""
    observations, values = toy.reset(seed=11)[0], []
    for _ in range(5):
        rows, _ = network.obs_to_tensor(stack(observations.values()))
        with torch.no_grad():
            values.append(network.predict_values(rows).numpy().ravel())
        observations, *_ = toy.step({})
    return np.array(values)


@pytest.mark.parametrize("toy", [ConstantReward, ConstantChoice])
def test_the_value_of_constant_reward_1_is_1_over_1_minus_gamma_despite_truncation(train, toy):
    # no clock: what is seen at the cut is also seen before, so its value is learned, not guessed
    training = train(lambda: toy(clock=False), CONSTANT_REWARD, segments=1)
    values = values_of(training.network, toy(clock=False))
    np.testing.assert_allclose(values, 1 / (1 - 0.5), rtol=0.02)


def test_the_value_before_a_termination_is_the_discounted_sum_up_to_it(train):
    longer = replace(CONSTANT_REWARD, total_steps=4096, segment_steps=4096, n_epochs=20)
    training = train(lambda: ConstantReward(truncates=False), longer, segments=1)
    expected = [sum(0.5**k for k in range(left)) for left in (5, 4, 3, 2, 1)]  # 1.94 ... 1
    values = values_of(training.network, ConstantReward())
    np.testing.assert_allclose(values, np.column_stack([expected] * 2), rtol=0.1)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_no_action_is_masked_or_out_of_its_space(train, make_env):
    settings = replace(TINY, log_std=1.0)  # most poses would be out of reach
    training = train(lambda: Strict(make_env()), settings, segments=2)
    assert training.steps == 256


def strict_world():
    return Strict(masked_world())


def broken_world():
    env = strict_world()
    env.step = fail
    return env


def fail(actions):
    raise OSError("broken")


def break_environments(runner):
    """From the next segment on, a runner makes environments that fail."""
    runner.config.environment(env_config={**runner.config.env_config, "env_factory": broken_world})


def check_error_is_reported(training, segment):
    with pytest.raises(RuntimeError) as raised:
        training.learn(segment)
    assert "OSError: broken" in "".join(traceback.format_exception(raised.value))


def test_an_error_of_an_environment_ends_the_training_and_is_reported(train):
    check_error_is_reported(train(broken_world), 0)


def check_killed_worker_is_reported(training, segment):
    victim, _ = training._on_runners(lambda runner: os.getpid())
    os.kill(victim, signal.SIGKILL)
    with pytest.raises(WorkerError, match="the same command continues the training after its last"):
        training.learn(segment)


@pytest.mark.parametrize("workers", [0, 2])
def test_a_resumed_training_ends_as_an_uninterrupted_one(train, workers, tmp_path):
    """With workers, also how their deaths and their errors are reported: each takes long to start.

    A worker of the first training is killed after its end, the environments of the second fail.
    """
    settings = replace(TINY, total_steps=384)
    whole = train(strict_world, settings, workers=workers, segments=1)
    save_checkpoint(tmp_path / "checkpoint.pt", whole.network, whole.network.optimizer, whole.steps)
    whole.learn(1)
    after, returns = parameters(whole.network).clone(), whole.report.returns
    assert whole.steps == 256
    if workers:
        check_killed_worker_is_reported(whole, 2)
    whole.close()  # its workers have all the processors
    resumed = train(strict_world, settings, workers=workers)
    resumed.steps = load_checkpoint(
        tmp_path / "checkpoint.pt", resumed.network, resumed.network.optimizer
    )
    resumed.learn(1)
    assert resumed.steps == 256
    assert torch.equal(parameters(resumed.network), after)
    assert resumed.report.returns == returns
    assert len(returns) == 2 * 4 * 4
    if workers:
        resumed._on_runners(break_environments)
        check_error_is_reported(resumed, 2)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_equal_seeds_give_equal_networks_and_others_other_networks(train, make_env):
    one, two, other = (
        parameters(train(make_env, seed=seed, segments=1).network) for seed in (0, 0, 1)
    )
    assert torch.equal(one, two)
    assert not torch.equal(one, other)


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_networks_and_checkpoints_are_those_of_stable_baselines3(train, make_env, tmp_path):
    ours, theirs = train(make_env), SB3Trainer(make_env, TINY, seed=0)
    assert torch.equal(parameters(ours.network), parameters(theirs.network))
    ours.learn(0)
    save_checkpoint(tmp_path / "ours.pt", ours.network, ours.network.optimizer, ours.steps)
    theirs.steps = load_checkpoint(tmp_path / "ours.pt", theirs.network, theirs.network.optimizer)
    assert theirs.steps == 128
    assert torch.equal(parameters(ours.network), parameters(theirs.network))
    momenta, own = (
        training.network.optimizer.state_dict()["state"][0]["exp_avg"]
        for training in (ours, theirs)
    )
    assert momenta.any()
    assert torch.equal(momenta, own)
    theirs.close()


@pytest.mark.parametrize("make_env", [small_world, masked_world])
def test_rllib_s_logits_and_values_are_those_of_the_network(train, make_env):
    network = train(make_env, segments=1).network
    rows = stack(make_env().reset(seed=5)[0].values())
    assert rows["map"].dtype == np.uint8  # scaled by Stable-Baselines3, or not at all
    module = shared_network_spec(shared_spaces(make_env, with_state=False), TINY, seed=3).build()
    module.network.load_state_dict(network.state_dict())
    given, _ = network.obs_to_tensor(rows)
    with torch.no_grad():
        expected = module.forward_inference({Columns.OBS: given})[Columns.ACTION_DIST_INPUTS]
        values = module.compute_values({Columns.OBS: given})
        theirs = network.get_distribution(given)
        assert torch.equal(values, network.predict_values(given).ravel())
    ours = module.get_inference_action_dist_cls().from_logits(expected)
    actions = theirs.get_actions(deterministic=True)
    torch.testing.assert_close(ours.logp(actions), theirs.log_prob(actions))
    torch.testing.assert_close(ours.entropy(), theirs.entropy())
    torch.testing.assert_close(ours.to_deterministic().sample(), actions)


def test_only_the_critic_learns_during_its_warmup(train):
    training = train(masked_world, replace(TINY, critic_warmup_steps=128))
    before = [parameters(training.network, critic=[own]).clone() for own in (False, True)]
    training.learn(0)
    assert torch.equal(parameters(training.network, critic=[False]), before[0])
    assert not torch.equal(parameters(training.network, critic=[True]), before[1])
    training.learn(1)
    assert not torch.equal(parameters(training.network, critic=[False]), before[0])


def test_a_warm_start_copies_the_given_network(train):
    given = train(masked_world, seed=5).network
    training = train(masked_world, replace(TINY, learning_rate=0.0))
    copy_weights(given, training.network)
    training.learn(0)
    assert torch.equal(parameters(training.network), parameters(given))


def test_a_central_critic_sees_the_state_of_the_team(train):
    training = train(StatefulEnv, replace(TINY, critic="central"), segments=1)
    assert "state" in training.network.observation_space.spaces
    rows, _ = training.network.obs_to_tensor(
        {"pose": np.zeros((2, 3), np.float32), "state": np.eye(2, dtype=np.float32)}
    )
    one, two = training.network.predict_values(rows)
    assert one != two


def test_a_segment_reports_returns_and_times(train):
    report = train(ConstantReward, segments=1).report
    assert set(report.returns) == {5.0}
    assert len(report.returns) == 2 * 4 * 3  # in 16 steps an episode of 5 ends three times
    assert 0 < report.environment_seconds < report.collecting_seconds < report.seconds


def test_rllib_s_own_checkpoints_work_too(tmp_path):
    config = make_config(masked_world, TINY, seed=0)
    with suppress_rllib_warnings():
        algorithm, again = config.copy().build_algo(), config.copy().build_algo()
    algorithm.train()
    algorithm.save_to_path(tmp_path)
    again.restore_from_path(tmp_path)
    one, two = (
        parameters(each.get_module(DEFAULT_MODULE_ID).network) for each in (algorithm, again)
    )
    assert torch.equal(one, two)
    again.train()
    assert not torch.equal(parameters(again.get_module(DEFAULT_MODULE_ID).network), one)
    for each in (algorithm, again):
        each.stop()


def test_a_training_writes_the_same_files_as_with_stable_baselines3(tmp_path):
    env_config = EnvConfig(
        "planar", {"action_mode": "candidates", "n_candidates": 6, "max_scans": 4}
    )
    config = TrainingConfig(env=env_config, ppo=TINY, seed=3, engine="rllib", validation_episodes=2)
    record = run_training(config, tmp_path)
    assert [row["steps"] for row in record["rows"]] == [0, 128, 256]
    LearnedPolicy(tmp_path / "policy.safetensors")
    assert len(list(tmp_path.glob("tensorboard/events*"))) == 1
    assert run_training(config, tmp_path) == record


def test_all_settings_reach_rllib():
    settings = PPOSettings(
        n_envs=6, rollout_steps=8, batch_size=24, n_epochs=3, learning_rate=0.01, gamma=0.8,
        gae_lambda=0.7, clip_range=0.15, entropy_coefficient=0.02, value_coefficient=0.4,
        max_gradient_norm=0.9,
    )  # fmt: skip
    config = make_config(lambda: masked_world(n_robots=3), settings, seed=4, workers=2)
    expected = {
        "num_env_runners": 2,
        "num_envs_per_env_runner": 3 * 3,  # a row for each of three robots
        "rollout_fragment_length": 8,
        "train_batch_size_per_learner": 6 * 8 * 3,
        "minibatch_size": 24,
        "num_epochs": 3,
        "lr": 0.01,
        "gamma": 0.8,
        "lambda_": 0.7,
        "clip_param": 0.15,
        "entropy_coeff": 0.02,
        "vf_loss_coeff": 0.4,
        "vf_clip_param": math.inf,
        "grad_clip": 0.9,
        "grad_clip_by": "global_norm",
        "use_kl_loss": False,
        "seed": 4,
    }
    assert {name: getattr(config, name) for name in expected} == expected


@pytest.mark.parametrize("workers", [-1, 3])
def test_workers_must_divide_the_environments(workers):
    with pytest.raises(ValueError, match=rf"0 or divide PPOSettings.n_envs = 4, got {workers}"):
        RLlibTrainer(ConstantReward, TINY, 0, workers)


def test_more_workers_than_processors_are_refused():
    with pytest.raises(ValueError, match=r"4 workers need a processor each, but .* with 2"):
        RLlibTrainer(ConstantReward, TINY, 0, 4)


@pytest.mark.parametrize("missing", ["ray", "torch"])
def test_a_missing_extra_is_named_with_its_pip_command(missing):
    extra = {"ray": "ray", "torch": "rl"}[missing]
    code = f"""
import sys
sys.modules[{missing!r}] = None
for module in ("rllib", "rllib.env", "rllib.network", "rllib.ppo"):
    try:
        __import__("coopmap_agents." + module)
    except ImportError as error:
        print(error)
"""
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    lines = run.stdout.splitlines()
    assert lines
    assert all(f"pip install 'coopmap[{extra}]'" in line for line in lines)
