"""Export trainings of several seeds as a pretrained policy: for maintainers, see `make policies`.

::

    python -m coopmap_agents.pretrained.export agents/pretrained/policies/NAME results/train/*
"""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coopmap_agents.pretrained.policy_file import convert_policy, load_policy
from coopmap_agents.record import POLICY_FILE, RECORD_FILE, Record, read_record
from coopmap_env.core.files import FileError, read_bytes, write_atomically


def export(folder: Path, trainings: Sequence[Path]) -> None:
    """Copy the policy of each training, also as ONNX, and write the record of all of them.

    Parameters
    ----------
    folder : Path
        Folder of the policy; its name is the policy's name.
    trainings : sequence of Path
        Folders of `run_training`; their configurations differ in the seed only.

    Raises
    ------
    ValueError
        If the trainings differ in more than their seeds, have equal seeds, or one is unfinished.
    FileError
        If a file of theirs is broken.
    """
    records = [_read_record(training) for training in trainings]
    _check_same_config(trainings, records)
    names = [f"seed_{record['config']['seed']}.safetensors" for record in records]
    policies = dict(zip(names, map(_read_policy, trainings), strict=True))
    for old in (*folder.glob("*.safetensors"), *folder.glob("*.onnx")):
        old.unlink()
    for name, content in policies.items():
        write_atomically(folder / name, content)
        convert_policy(folder / name, (folder / name).with_suffix(".onnx"))
    write_atomically(folder / RECORD_FILE, json.dumps(_summary(records), indent=1) + "\n")


def _check_same_config(trainings: Sequence[Path], records: Sequence[Mapping[str, Any]]) -> None:
    seeds = [record["config"]["seed"] for record in records]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"the seeds of trainings must differ, got {seeds}")
    configs = [{**record["config"], "seed": None} for record in records]
    for training, record, config in zip(trainings, records, configs, strict=True):
        if config != configs[0]:
            raise ValueError(f"{training} and {trainings[0]} differ in more than their seeds")
        total_steps = config["ppo"]["total_steps"]
        if record["rows"][-1]["steps"] < total_steps:
            raise ValueError(f"{training} is unfinished: it has not reached {total_steps} steps")


def _read_record(training: Path) -> Record:
    record = read_record(training)
    if record is None:
        raise FileError(f"{training / RECORD_FILE}: there is no such file")
    return record


def _read_policy(training: Path) -> bytes:
    """Content of the file of a training's policy, which can be loaded."""
    load_policy(training / POLICY_FILE)
    return read_bytes(training / POLICY_FILE)


def _summary(records: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Values that are the same in all trainings, and the learning curve of each."""
    first = records[0]
    best = max(records, key=_best_reward)
    return {
        "version": first["version"],
        "machine": first["machine"],
        "config": {**first["config"], "seed": None},
        "seeds": sorted(record["config"]["seed"] for record in records),
        "best_seed": best["config"]["seed"],
        "trainings": {
            str(record["config"]["seed"]): _training_summary(record) for record in records
        },
    }


def _training_summary(record: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "command": record["command"],
        "imitation": record["imitation"],
        "best_row": record["best"],
        "rows": record["rows"],
    }


def _best_reward(record: Mapping[str, Any]) -> float:
    return float(record["rows"][record["best"]]["validation"]["reward"])


if __name__ == "__main__":
    export(Path(sys.argv[1]), [Path(argument) for argument in sys.argv[2:]])
