import re
import subprocess
import sys

import pytest

from coopmap_agents.config import EnvConfig, PPOSettings


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("n_envs", 0),
        ("total_steps", -1),
        ("critic_warmup_steps", -1),
        ("gamma", 1.1),
        ("gae_lambda", -0.1),
        ("segment_steps", 0),
        ("hidden", ()),
        ("hidden", (16, 0)),
        ("hidden", (10**9, 16)),
        ("image_features", 10**9),
        ("n_envs", 10**9),
        ("batch_size", 1),
        ("clip_range", -1.0),
        ("learning_rate", -1.0),
        ("initial_policy", "best"),
        ("critic", "none"),
    ],
)
def test_invalid_settings_are_refused_with_their_value(name, value):
    with pytest.raises(
        ValueError, match=rf"PPOSettings\.{name} must .*, got {re.escape(repr(value))}"
    ):
        PPOSettings(**{name: value})


def test_a_network_of_too_many_layers_and_a_roll_out_of_too_many_steps_are_refused():
    with pytest.raises(
        ValueError, match=r"PPOSettings\.hidden must have 1 to 64 layers, got \(8, 8"
    ):
        PPOSettings(hidden=(8,) * 65)
    with pytest.raises(
        ValueError, match=r"n_envs times rollout_steps has 6,000,000,000 cells, more"
    ):
        PPOSettings(n_envs=60_000, rollout_steps=100_000)


def test_an_env_config_makes_environments_of_its_splits():
    env_config = EnvConfig("planar", {"n_robots": 3, "action_mode": "candidates"})
    assert env_config().split == "train"
    assert env_config.make("validation").split == "validation"
    assert len(env_config().possible_agents) == 3
    assert env_config() is not env_config()


def test_settings_and_the_command_need_no_torch():
    code = "import coopmap_agents.commands, sys; print('torch' in sys.modules)"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "False\n"
