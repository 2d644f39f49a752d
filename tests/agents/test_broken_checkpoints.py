"""Broken checkpoints of trainings, and those of others: one error, and no code runs."""

import io
import os
import zipfile

import numpy as np
import pytest
import torch
from plain.fuzz import cases, mutants, read_or_refuse
from tiny_policies import tiny_network

from coopmap_agents.training import load_checkpoint, save_checkpoint
from coopmap_env.core.files import FileError


def checkpoint_of(folder, **changes):
    """A checkpoint with other values, and the network that it was of."""
    network = tiny_network()
    network.optimizer.zero_grad()
    sum(values.sum() for values in network.parameters()).backward()
    network.optimizer.step()
    save_checkpoint(folder / "checkpoint-3.pt", network, network.optimizer, 128)
    values = torch.load(folder / "checkpoint-3.pt", weights_only=True)
    torch.save({**values, **changes}, folder / "checkpoint-3.pt")
    return values, folder / "checkpoint-3.pt"


def load(path, steps=None):
    network = tiny_network()
    return load_checkpoint(path, network, network.optimizer, steps)


def test_a_checkpoint_gives_the_network_and_its_optimizer_back(tmp_path):
    values, path = checkpoint_of(tmp_path)
    network = tiny_network(seed=1)
    assert load_checkpoint(path, network, network.optimizer, 128) == 128
    assert network.optimizer.state_dict()["state"][0]["step"] == 1
    for name, weights in network.state_dict().items():
        np.testing.assert_array_equal(weights, values["network"][name])


@pytest.mark.parametrize("content", [b"", b"broken", b"PK\x03\x04", b"\x80\x02}q\x00."])
def test_a_checkpoint_that_is_none_is_refused_by_name(content, tmp_path):
    path = tmp_path / "checkpoint-3.pt"
    path.write_bytes(content)
    with pytest.raises(
        FileError, match=rf"^the checkpoint {path} cannot be read .*remove its fold"
    ):
        load(path)


def test_a_checkpoint_with_code_is_refused_and_the_code_does_not_run(tmp_path):
    class Attack:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "attacked"),)

    path = tmp_path / "checkpoint-3.pt"
    torch.save({"steps": 128, "network": Attack(), "optimizer": {}}, path)
    with pytest.raises(FileError, match=rf"^the checkpoint {path} cannot be read"):
        load(path)
    assert not (tmp_path / "attacked").exists()


def test_a_checkpoint_that_is_a_link_or_a_folder_is_refused(tmp_path):
    _, path = checkpoint_of(tmp_path)
    link = tmp_path / "checkpoint-4.pt"
    link.symlink_to(path)
    with pytest.raises(FileError, match=r"checkpoint-4\.pt cannot be read \(it is a link\)"):
        load(link)
    (tmp_path / "checkpoint-5.pt").mkdir()
    with pytest.raises(FileError, match=r"checkpoint-5\.pt cannot be read "):
        load(tmp_path / "checkpoint-5.pt")


def test_a_checkpoint_that_is_larger_inside_is_refused_before_it_is_unpacked(tmp_path):
    _, path = checkpoint_of(tmp_path)
    packed = io.BytesIO()
    with (
        zipfile.ZipFile(path) as archive,
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for entry in archive.infolist():
            content = archive.read(entry)
            target.writestr(entry.filename, bytes(10**6) if "/data/" in entry.filename else content)
    path.write_bytes(packed.getvalue())
    with pytest.raises(FileError, match=r"cannot be read \(its records are larger than the file\)"):
        load(path)


def test_a_checkpoint_of_other_values_is_refused_with_what_differs(tmp_path):
    values, _ = checkpoint_of(tmp_path)
    weights, optimizer = values["network"], values["optimizer"]
    name, group = "network.rating_weight", optimizer["param_groups"][0]
    nan, wide = torch.tensor(float("nan")), torch.zeros(1).expand(10**6)
    state = optimizer["state"]
    for changes, named in (
        ({"steps": 64}, "it is after 64 steps, not 128"),
        ({"steps": "128"}, "it is after '128' steps, not 128"),
        ({"network": {**weights, name: nan}}, rf"{name} must be finite numbers"),
        ({"network": {**weights, name: wide}}, rf"{name} has the shape \(1000000,\), not \(\)"),
        ({"network": {**weights, name: 3.0}}, rf"{name} has the shape \(\), not \(\)"),
        ({"network": {**weights, name: torch.tensor(1)}}, rf"{name} is of type torch\.int64"),
        ({"network": {}}, r"the weights are \[\], not "),
        ({"network": 3}, "'int' object is not iterable"),
        ({"optimizer": {**optimizer, "param_groups": [{**group, "lr": 5.0}]}}, "other settings"),
        ({"optimizer": {"state": {}}}, "'param_groups'"),
        ({"optimizer": {**optimizer, "state": {10**6: state[0]}}}, "index out of range"),
        ({"optimizer": {**optimizer, "state": {0: {**state[0], "step": nan}}}}, "step must be fin"),
        ({"optimizer": {**optimizer, "state": {0: {"step": nan}}}}, r"state\[0\] are \['step'\]"),
        ({"other": 1}, "cannot be read .*it holds"),
    ):
        _, path = checkpoint_of(tmp_path, **changes)
        with pytest.raises(
            FileError, match=rf"^the checkpoint {path} .*{named}.*remove its folder"
        ):
            load(path, 128)


@cases(short=300, long=20_000)
def test_a_mutated_checkpoint_is_read_or_refused_by_name(n_cases, tmp_path):
    _, path = checkpoint_of(tmp_path)
    network = tiny_network()
    for mutant in mutants([path.read_bytes()], n_cases):
        path.write_bytes(mutant)
        steps = read_or_refuse(
            lambda file: load_checkpoint(file, network, network.optimizer, 128),
            path,
            FileError,
            "the checkpoint ",
        )
        if steps is not None:
            assert all(values.isfinite().all() for values in network.parameters())
