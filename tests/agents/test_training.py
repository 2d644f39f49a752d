"""A training in a folder: its files, and that an interruption changes nothing."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
import torch
from gymnasium import spaces
from plain.toy_team import ConstantReward
from safetensors.torch import load_file

from coopmap_agents.config import EnvConfig, ImitationSettings, PPOSettings, TrainingConfig
from coopmap_agents.pretrained import LearnedPolicy, read_metadata
from coopmap_agents.sb3 import make_model
from coopmap_agents.training import load_checkpoint, run_training, save_checkpoint
from coopmap_agents.training import loop as training
from coopmap_baselines import make
from coopmap_env.cli import main
from coopmap_env.evaluation import evaluate
from coopmap_env.mapping.files import write_map_server

ENV_CONFIG = EnvConfig("planar", {"action_mode": "candidates", "n_candidates": 6, "max_scans": 4})
SETTINGS = PPOSettings(
    total_steps=192, segment_steps=64, n_envs=2, rollout_steps=16, batch_size=32, n_epochs=2,
    hidden=(16,), image_features=8,
)  # fmt: skip
CONFIG = TrainingConfig(env=ENV_CONFIG, ppo=SETTINGS, seed=3, validation_episodes=2)


class Interrupted(Exception):  # noqa: N818  # no error
    pass


def interrupt_after(n_segments):
    lines = []

    def log(line):
        lines.append(line)
        if len(lines) == 1 + n_segments:  # the first line comes before all segments
            raise Interrupted

    return log


def untimed(record):
    """A record without times."""
    rows = [{k: v for k, v in row.items() if "seconds" not in k} for row in record["rows"]]
    return {**record, "rows": rows}


def weights(folder):
    return torch.cat([p.ravel() for p in load_file(folder / "policy.safetensors").values()])


def checkpoint(folder):
    (path,) = folder.glob("checkpoint-*.pt")
    return torch.load(path, weights_only=True)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder and record of an uninterrupted training."""
    folder = tmp_path_factory.mktemp("whole")
    return folder, run_training(CONFIG, folder)


@pytest.fixture(scope="module")
def whole_sb3(tmp_path_factory):
    """The same by Stable-Baselines3."""
    folder = tmp_path_factory.mktemp("whole_sb3")
    return folder, run_training(replace(CONFIG, engine="sb3"), folder)


@pytest.mark.parametrize(("n_segments", "workers"), [(1, 0), (2, 0), (1, 2)])
@pytest.mark.parametrize("engine", ["ppo", "sb3"])
def test_a_resumed_training_ends_as_an_uninterrupted_one(
    whole, whole_sb3, engine, n_segments, workers, tmp_path
):
    config, expected = replace(CONFIG, engine=engine), whole if engine == "ppo" else whole_sb3
    with pytest.raises(Interrupted):
        run_training(config, tmp_path, workers, interrupt_after(n_segments))
    record = run_training(config, tmp_path, workers)
    assert untimed(record) == untimed(expected[1])
    ours, theirs = checkpoint(tmp_path), checkpoint(expected[0])
    assert ours["steps"] == theirs["steps"] == 192
    for name, values in theirs["network"].items():
        assert torch.equal(ours["network"][name], values)
    assert torch.equal(weights(tmp_path), weights(expected[0]))


def test_engines_start_at_the_same_network_and_learn_others(whole, whole_sb3):
    first, other = whole[1]["rows"][0], whole_sb3[1]["rows"][0]
    assert first["validation"] == other["validation"]
    assert not torch.equal(
        checkpoint(whole[0])["network"]["network.score.weight"],
        checkpoint(whole_sb3[0])["network"]["network.score.weight"],
    )


def test_a_training_killed_while_writing_resumes_from_the_segment_before(
    whole, tmp_path, monkeypatch
):
    written = []

    def dies_in_the_second_segment(path, text):
        written.append(path)
        if len(written) == 3:
            raise Interrupted
        path.write_text(text, encoding="utf-8")

    with monkeypatch.context() as patch:
        patch.setattr(training, "write_atomically", dies_in_the_second_segment)
        with pytest.raises(Interrupted):
            run_training(CONFIG, tmp_path)
    assert {path.name for path in tmp_path.glob("checkpoint-*")} == {
        "checkpoint-2.pt", "checkpoint-3.pt",
    }  # fmt: skip
    assert untimed(run_training(CONFIG, tmp_path)) == untimed(whole[1])
    assert {path.name for path in tmp_path.glob("checkpoint-*")} == {"checkpoint-4.pt"}


def test_a_longer_training_resumes_a_shorter_one(whole, tmp_path):
    run_training(replace(CONFIG, ppo=replace(SETTINGS, total_steps=128)), tmp_path)
    assert untimed(run_training(CONFIG, tmp_path)) == untimed(whole[1])


def test_a_finished_training_is_not_trained_again(whole):
    folder, record = whole
    before = (folder / "training.json").stat().st_mtime_ns
    assert run_training(CONFIG, folder) == record
    assert (folder / "training.json").stat().st_mtime_ns == before


def test_the_policy_is_the_best_one_on_validation_worlds(whole):
    folder, record = whole
    rewards = [row["validation"]["reward"] for row in record["rows"]]
    assert record["rows"][record["best"]]["validation"]["reward"] == max(rewards)
    path = folder / "policy.safetensors"
    table = evaluate(ENV_CONFIG.make("validation"), LearnedPolicy(path), range(2)).table
    assert table["reward"].mean() == pytest.approx(max(rewards), abs=0)
    assert read_metadata(folder / "policy.onnx") == read_metadata(path)
    origin = read_metadata(path).training
    assert origin["config"]["seed"] == 3
    assert origin["config"]["env"]["arguments"]["n_candidates"] == 6


def test_the_record_has_times_and_returns(whole):
    folder, record = whole
    assert json.loads((folder / "training.json").read_text()) == record
    assert [row["steps"] for row in record["rows"]] == [0, 64, 128, 192]
    for row in record["rows"][1:]:
        assert 0 < row["environment_seconds"] < row["collecting_seconds"] < row["seconds"]
        assert np.isfinite(row["team_return"])
    assert record["rows"][0]["team_return"] is None
    assert list((folder / "tensorboard").glob("events*"))


@pytest.mark.parametrize(
    ("other", "named"),
    [
        (replace(CONFIG, seed=4), r"config\.seed = 3, not 4"),
        (
            replace(CONFIG, ppo=replace(SETTINGS, gamma=0.5)),
            r"config\.ppo\.gamma = 0\.8, not 0\.5",
        ),
        (
            replace(CONFIG, env=EnvConfig("planar", {**ENV_CONFIG.arguments, "n_robots": 3})),
            r"config\.env\.arguments\.n_robots = None, not 3",
        ),
    ],
)
def test_the_folder_of_another_training_is_refused_with_the_difference(whole, other, named):
    with pytest.raises(ValueError, match=f"holds another training, with {named}: use another"):
        run_training(other, whole[0])


def test_a_training_with_a_shortened_last_segment_is_not_extended(tmp_path):
    short, longer = (
        replace(CONFIG, ppo=replace(SETTINGS, segment_steps=128, total_steps=total))
        for total in (192, 256)
    )
    assert [row["steps"] for row in run_training(short, tmp_path)["rows"]] == [0, 128, 192]
    with pytest.raises(ValueError, match=r"ended after 192 steps .* cannot be extended to 256"):
        run_training(longer, tmp_path)


def test_the_initial_network_is_validated_and_kept_if_it_is_the_best(tmp_path):
    still = replace(SETTINGS, learning_rate=0.0, total_steps=64, initial_policy="rating")
    record = run_training(replace(CONFIG, ppo=still), tmp_path)
    planner = evaluate(ENV_CONFIG.make("validation"), make("rating_function"), range(2)).table
    assert record["rows"][0]["validation"]["reward"] == planner["reward"].mean()
    assert read_metadata(tmp_path / "policy.safetensors").training["steps"] in (0, 64)


def test_a_training_can_start_from_a_policy(whole, tmp_path):
    path = str(whole[0] / "policy.safetensors")
    config = replace(CONFIG, init_from=path, ppo=replace(SETTINGS, total_steps=64))
    record = run_training(config, tmp_path)
    best = whole[1]["rows"][whole[1]["best"]]
    assert record["rows"][0]["validation"] == best["validation"]
    assert list(record["files"]) == [path]


def test_a_changed_scene_file_is_another_training(tmp_path):
    scene = tmp_path / "map.yaml"
    walls = np.zeros((60, 60))
    walls[[0, -1], :] = walls[:, [0, -1]] = 1.0
    write_map_server(scene, walls, resolution=0.2, origin=(0.0, 0.0))
    config = replace(
        CONFIG,
        env=EnvConfig("planar", {**ENV_CONFIG.arguments, "scene": str(scene)}),
        ppo=replace(SETTINGS, total_steps=64),
    )
    run_training(config, tmp_path / "training")
    walls[20, 5:30] = 1.0
    write_map_server(scene, walls, resolution=0.2, origin=(0.0, 0.0))
    with pytest.raises(ValueError, match=r"another training, with files\..*map\."):
        run_training(config, tmp_path / "training")


def test_a_missing_device_is_refused(tmp_path):
    config = replace(CONFIG, ppo=replace(SETTINGS, device="mainframe"))
    with pytest.raises(ValueError, match=r"PPOSettings\.device 'mainframe' is not available"):
        run_training(config, tmp_path)


def test_a_map_that_looks_like_channels_last_is_refused():
    image = spaces.Box(0, 255, (32, 24, 24), np.uint8)

    class Deep(ConstantReward):
        def observation_space(self, agent):
            return spaces.Dict({"map": image, **super().observation_space(agent).spaces})

    with pytest.raises(ValueError, match=r"map has the shape \(32, 24, 24\), with more channels"):
        make_model(Deep, SETTINGS, seed=0)


def test_an_initial_policy_of_the_rating_needs_candidates():
    with pytest.raises(ValueError, match='initial_policy="rating" needs candidates as actions'):
        make_model(EnvConfig("planar"), replace(SETTINGS, initial_policy="rating"), seed=0)


def test_broken_files_are_named(whole, tmp_path):
    (tmp_path / "training.json").write_text('{"config": {}, "rows": []}')
    with pytest.raises(ValueError, match=r"training\.json is broken .*'best'.* remove its folder"):
        run_training(CONFIG, tmp_path)
    (tmp_path / "training.json").write_text("{")
    with pytest.raises(ValueError, match=r"training\.json is broken .* remove its folder"):
        run_training(CONFIG, tmp_path)
    longer = replace(CONFIG, ppo=replace(SETTINGS, total_steps=256))
    (tmp_path / "training.json").write_text(json.dumps(whole[1]))
    with pytest.raises(ValueError, match=r"checkpoint .*checkpoint-4\.pt cannot be read"):
        run_training(longer, tmp_path)
    (tmp_path / "checkpoint-4.pt").write_bytes(b"broken")
    with pytest.raises(ValueError, match=r"checkpoint .*checkpoint-4\.pt cannot be read"):
        run_training(longer, tmp_path)


def test_the_checkpoint_of_another_network_is_refused(tmp_path):
    one, other = (
        make_model(ENV_CONFIG, replace(SETTINGS, hidden=hidden), seed=0).policy
        for hidden in ((16,), (8,))
    )
    save_checkpoint(tmp_path / "other.pt", other, other.optimizer, steps=64)
    with pytest.raises(ValueError, match=r"other\.pt is of another network: "):
        load_checkpoint(tmp_path / "other.pt", one, one.optimizer)


def test_a_training_can_start_with_imitation(tmp_path):
    config = replace(
        CONFIG,
        ppo=replace(SETTINGS, total_steps=64, learning_rate=1e-12),
        imitate="rating_function",
        imitation=ImitationSettings(episodes=6, rounds=2, epochs=8, batch_size=16),
    )
    record = run_training(config, tmp_path)
    assert record["imitation"]["n_train"] == 2 * 5 * 4 * 2
    assert record["imitation"]["agreement"] > 0.5  # one of six by chance


def test_a_central_critic_learns_from_the_state_and_the_policy_does_not_need_it(tmp_path):
    config = replace(CONFIG, ppo=replace(SETTINGS, total_steps=64, critic="central"))
    run_training(config, tmp_path)
    policy = LearnedPolicy(tmp_path / "policy.safetensors")
    assert evaluate(ENV_CONFIG.make("test"), policy, [0]).table["coverage"][0] > 0


def test_the_command_trains_and_its_policy_is_evaluated(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    main([
        "train", "--out", "t", "--max-scans", "4", "--n-candidates", "6", "--validation-episodes",
        "2", "--ppo.total-steps", "64", "--ppo.rollout-steps", "16", "--ppo.n-envs", "2",
        "--ppo.batch-size", "32",
    ])  # fmt: skip
    printed = capsys.readouterr().err
    assert "64 of 64 steps" in printed
    assert re.search(
        r"agent-steps/s: environment \d+%, network while collecting \d+%, updates \d+%", printed
    )
    assert re.search(r"policy: t/policy\.safetensors, after (0|64) steps; ", printed)
    main([
        "evaluate", "--policies", "learned:model=t/policy.safetensors", "--action-mode",
        "candidates", "--episodes", "2", "--max-scans", "4", "--out", "e",
    ])  # fmt: skip
    assert "area under curve" in capsys.readouterr().out


def test_invalid_configurations_are_refused():
    with pytest.raises(
        ValueError,
        match=r"TrainingConfig\.engine must be one of 'ppo', 'sb3', 'rllib', got 'torchrl'",
    ):
        replace(CONFIG, engine="torchrl")
    with pytest.raises(
        ValueError, match=r"TrainingConfig\.validation_episodes must be .* >= 1, got 0"
    ):
        replace(CONFIG, validation_episodes=0)
