"""Broken folders of trainings, and those of others: one error, and no file outside is touched."""

import json
from dataclasses import replace

import pytest
from plain.fuzz import cases, mutants, read_or_refuse
from tiny_policies import SETTINGS, tiny_network

from coopmap_agents.config import EnvConfig, TrainingConfig
from coopmap_agents.pretrained import library
from coopmap_agents.pretrained.export import export
from coopmap_agents.record import (
    SegmentReport,
    add_row,
    check_same_training,
    new_record,
    read_record,
)
from coopmap_agents.training import run_training, save_checkpoint
from coopmap_env.core.files import FileError

PPO = replace(SETTINGS, segment_steps=64, total_steps=192)
CONFIG = TrainingConfig(env=EnvConfig("planar", {"n_robots": 2}), ppo=PPO)
SCORES = {
    "coverage_auc": 0.05, "coverage": 0.1, "reward": 0.25, "log_loss": 0.01, "motion_distance": 90.0
}  # fmt: skip


def good_record():
    """A record after three rows, of which the second is the best."""
    record = new_record(CONFIG, "coopmap train", 0)
    for k, reward in enumerate((0.25, 0.5, 0.375)):
        report = SegmentReport(2.0, 0.5, 1.5, [1.0, 2.0]) if k else SegmentReport()
        add_row(record, 64 * k, 2, report, {**SCORES, "reward": reward}, 1.0)
    return {**record, "best": 1, "checkpoint": "checkpoint-3.pt"}


def write(folder, record):
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "training.json").write_text(json.dumps(record))
    return folder


def with_row(k, **changes):
    record = good_record()
    record["rows"][k] = {**record["rows"][k], **changes}
    return record


def test_a_good_record_is_read_as_it_is(tmp_path):
    assert read_record(write(tmp_path, good_record())) == good_record()
    check_same_training(good_record(), CONFIG, 0, tmp_path)


@pytest.mark.parametrize(
    "name",
    [
        "../precious.txt", "/etc/passwd", "checkpoint-3.pt/../../precious.txt", "checkpoint-2.pt",
        "checkpoint-3.PT", "./checkpoint-3.pt", "checkpoint-3.pt\0", "training.json", "", ".", "..",
        "tensorboard", "policy.safetensors", None, 3, ["checkpoint-3.pt"],
    ],
)  # fmt: skip
def test_a_record_can_name_no_file_but_its_own_checkpoint(name, tmp_path):
    precious = tmp_path / "precious.txt"
    precious.write_text("precious")
    folder = write(tmp_path / "training", {**good_record(), "checkpoint": name})
    network = tiny_network()
    save_checkpoint(folder / "checkpoint-3.pt", network, network.optimizer, 128)
    with pytest.raises(
        FileError, match=rf"^{folder}/training\.json is broken .*checkpoint.*: remove its folder to"
    ):
        run_training(CONFIG, folder)
    assert precious.read_text() == "precious"
    assert (folder / "checkpoint-3.pt").exists()


@pytest.mark.parametrize(
    ("record", "named"),
    [
        ([], r"expected a JSON object, got \[\]"),
        (3, "expected a JSON object, got 3"),
        ({}, "without .*'best'"),
        ({**good_record(), "rows": [{}]}, r"row 0: .*missing .*'steps'"),
        ({**good_record(), "rows": [[]]}, r"row 0: SegmentRow must be a mapping"),
        ({**good_record(), "rows": {}}, r"rows must be a list, got \{\}"),
        ({**good_record(), "rows": []}, r"steps of rows must increase from 0, got \[\]"),
        (with_row(0, steps=64), r"steps of rows must increase from 0, got \[64, 64, 128\]"),
        (with_row(1, steps="64"), r"row 1: SegmentRow\.steps must be an integer .*, got '64'"),
        (with_row(1, steps=64.5), r"row 1: SegmentRow\.steps must be an integer .*, got 64\.5"),
        (with_row(2, steps=10**30), r"row 2: SegmentRow\.steps must be an integer"),
        (with_row(2, seconds=0), r"the seconds of a segment must be above 0"),
        (with_row(2, seconds=-1.0), r"row 2: SegmentRow\.seconds must be a finite number >= 0"),
        (with_row(2, team_return="high"), r"row 2: SegmentRow\.team_return must be "),
        (with_row(2, validation={}), r"row 2: ValidationScores: .*missing .*'reward'"),
        (with_row(2, validation=[0.5]), r"row 2: SegmentRow\.validation must be Val"),
        (
            with_row(2, validation={**SCORES, "reward": float("nan")}),
            r"row 2: ValidationScores\.reward must be a finite number, got nan",
        ),
        (with_row(2, note="new"), r"row 2: unknown settings \['note'\]"),
        ({**good_record(), "best": 3}, r"best must be the index of the row with the largest .* 3"),
        ({**good_record(), "best": 0}, r"best must be the index of the row with the largest .* 0"),
        ({**good_record(), "best": -1}, r"TrainingRecord\.best must be an integer >= 0, got -1"),
        ({**good_record(), "best": None}, r"TrainingRecord\.best must be an integer .*, got None"),
        ({**good_record(), "best": True}, r"TrainingRecord\.best must be an integer .*, got True"),
        ({**good_record(), "config": {}}, r"TrainingConfig: .*missing .*'env'"),
        ({**good_record(), "config": 5}, r"TrainingRecord\.config must be TrainingConfig, got 5"),
        ({**good_record(), "config": {"env": {}, "speed": 1}}, r"unknown settings \['speed'\]"),
        ({**good_record(), "files": ["a"]}, r"files must be hashes by path, got "),
        ({**good_record(), "workers": "2"}, r"TrainingRecord\.workers must be "),
        ({**good_record(), "imitation": {"n_train": 3}}, r"ImitationRow: .*missing"),
        ({**good_record(), "version": 3}, r"TrainingRecord\.version must be str, got 3"),
        ({**good_record(), "owner": "me"}, r"unknown settings \['owner'\]"),
    ],
)
def test_a_record_of_another_form_is_refused_with_the_field(record, named, tmp_path):
    folder = write(tmp_path / "training", record)
    with pytest.raises(
        FileError, match=rf"^{folder}/training\.json is broken \(.*{named}.*remove its folder to st"
    ):
        read_record(folder)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe{}", b"[" * 100_000, b"9" * 5000, b"NaN"])
def test_a_record_that_is_no_json_is_refused_by_name(content, tmp_path):
    (tmp_path / "training.json").write_bytes(content)
    with pytest.raises(FileError, match=rf"^{tmp_path}/training\.json"):
        read_record(tmp_path)


def test_a_record_of_another_version_says_which(tmp_path):
    write(tmp_path, {**good_record(), "version": "9.9.9", "new": 1})
    with pytest.raises(
        FileError, match=r"training by coopmap 9\.9\.9, this is .*: use another fold"
    ):
        run_training(CONFIG, tmp_path)


def test_a_record_that_is_a_folder_or_a_link_to_nothing_is_refused(tmp_path):
    (tmp_path / "one" / "training.json").mkdir(parents=True)
    with pytest.raises(FileError, match=r"training\.json cannot be read"):
        read_record(tmp_path / "one")
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "training.json").symlink_to(tmp_path / "missing")
    with pytest.raises(FileError, match=r"training\.json is broken \(there is no such file"):
        read_record(tmp_path / "other")


def test_long_values_of_a_record_are_cut_in_the_message(tmp_path):
    record = good_record()
    record["config"]["env"]["arguments"] = {"n_robots": "2" * 10**6}
    with pytest.raises(ValueError, match=r"config\.env\.arguments\.n_robots = ") as caught:
        check_same_training(record, CONFIG, 0, tmp_path)
    assert len(str(caught.value)) < 1000


def test_a_broken_record_is_not_exported(tmp_path):
    folder = write(tmp_path / "training", {**good_record(), "rows": [{}]})
    with pytest.raises(FileError, match=rf"^{folder}/training\.json is broken"):
        export(tmp_path / "small", [folder])
    assert not (tmp_path / "small").exists()


def test_a_training_without_a_policy_is_not_exported_and_an_older_export_stays(tmp_path):
    record = with_row(2, steps=192)
    folder = write(tmp_path / "training", record)
    (tmp_path / "small").mkdir()
    (tmp_path / "small" / "seed_7.safetensors").write_bytes(b"older")
    with pytest.raises(FileError, match=rf"^{folder}/policy\.safetensors: there is no such file"):
        export(tmp_path / "small", [folder])
    (folder / "policy.safetensors").write_bytes(b"broken")
    with pytest.raises(FileError, match=rf"^{folder}/policy\.safetensors was not written by"):
        export(tmp_path / "small", [folder])
    assert [path.name for path in (tmp_path / "small").iterdir()] == ["seed_7.safetensors"]
    with pytest.raises(FileError, match=rf"^{tmp_path}/training\.json: there is no such file"):
        export(tmp_path / "small", [tmp_path])


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("{", "expected JSON"),
        ("[]", "is broken .*install coopmap again"),
        ('{"seeds": ["../precious"], "best_seed": "../precious"}', "seeds must be integers"),
        ('{"seeds": 0, "best_seed": 0}', "seeds must be integers"),
        ('{"seeds": [0], "best_seed": "../precious"}', "best_seed must be one of"),
        ('{"seeds": [0, 1], "best_seed": true}', "best_seed must be one of"),
        ('{"seeds": [0], "best_seed": 0, "trainings": {}}', "trainings must be of the seeds"),
        (
            '{"seeds": [0], "best_seed": 0, "trainings": {"0": {"rows": [{}], "best_row": 0}}}',
            "row 0: SegmentRow: .*missing",
        ),
        (
            '{"seeds": [0], "best_seed": 0, "trainings": {"0": {"rows": [], "best_row": 0}}}',
            "seed 0: best_row must be a row, got 0",
        ),
        ('{"seeds": [0], "best_seed": 0, "trainings": {"0": []}}', "is broken"),
        ('{"seeds": [0]}', "is broken .*best_seed"),
    ],
)
def test_the_record_of_a_pretrained_policy_can_name_no_file(content, named, tmp_path, monkeypatch):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "training.json").write_text(content)
    monkeypatch.setattr(library, "_folder", lambda: tmp_path)
    with pytest.raises(FileError, match=rf"^{tmp_path}/mine/training\.json.*{named}"):
        library.pretrained_path("mine")


@cases(short=1500, long=100_000)
def test_a_mutated_record_is_read_or_refused_by_name(n_cases, tmp_path):
    path = tmp_path / "training.json"
    for mutant in mutants([json.dumps(good_record()).encode()], n_cases):
        path.write_bytes(mutant)
        record = read_or_refuse(lambda file: read_record(file.parent), path, FileError)
        if record is not None:
            assert record["checkpoint"] == f"checkpoint-{len(record['rows'])}.pt"
