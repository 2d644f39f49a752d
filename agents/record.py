"""The record of a training, training.json: configuration, machine, one row for each segment."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_agents._record_form import ValidationScores, check_record
from coopmap_agents.config import TrainingConfig
from coopmap_env.core.files import FileError, brief, read_json
from coopmap_env.core.version import __version__
from coopmap_env.evaluation import file_hashes

RECORD_FILE = "training.json"
POLICY_FILE = "policy.safetensors"
ONNX_FILE = "policy.onnx"

Record = dict[str, Any]
"""JSON values, as `coopmap_agents._record_form.TrainingRecord` describes them."""
VALIDATION_SCORES = tuple(field.name for field in fields(ValidationScores))
"""Columns of an evaluation's table; the record has their means over the validation worlds."""


@dataclass(frozen=True)
class SegmentReport:
    """Wall-clock time of a segment, and the returns of its episodes."""

    seconds: float = 0.0
    """Duration of the segment."""
    environment_seconds: float = 0.0
    """Part of it in which the environments were stepped."""
    collecting_seconds: float = 0.0
    """Part of it in which roll-outs were collected, with the environments; the rest are updates."""
    returns: Sequence[float] = ()
    """Sum of rewards of each robot in each episode that ended."""


def new_record(config: TrainingConfig, command: str, workers: int) -> Record:
    """Record of a training that has not started."""
    return {
        "version": __version__,
        "command": command,
        "machine": machine_description(),
        "config": config_to_dict(config),
        "files": _file_hashes(config),
        "workers": _recorded_workers(config, workers),
        "imitation": None,
        "rows": [],
        "best": None,
        "checkpoint": "",
    }


def machine_description() -> str:
    """Processor, cores and versions: they decide the speed, and the last bits of the weights."""
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, torch {version('torch')}"
    )


def read_record(folder: Path) -> Record | None:
    """Read the record of a training's folder; None if it has none.

    Raises
    ------
    FileError
        If the file is broken, or of another version of coopmap.
    """
    path = folder / RECORD_FILE
    if not os.path.lexists(path):
        return None
    try:
        record = read_json(path)
        recorded_version = record.get("version") if isinstance(record, dict) else None
        is_of_this_version = recorded_version == __version__
        if is_of_this_version or not isinstance(recorded_version, str):
            check_record(record)
    except (ValueError, RecursionError) as error:
        reason = str(error).removeprefix(f"{path}: ")
        raise FileError(f"{path} is broken ({reason}): remove its folder to start again") from error
    if not is_of_this_version:
        raise FileError(
            f"{path} is of a training by coopmap {recorded_version:.40}, this is {__version__}: "
            "use another folder, or install that version to go on"
        )
    checked: Record = record
    return checked


def check_same_training(record: Record, config: TrainingConfig, workers: int, out: Path) -> None:
    """Check that a record is of this training; only the length may differ.

    Raises
    ------
    ValueError
        With the first difference, or if the last segment was shortened, so that a longer training
        would have continued differently.
    """
    requested = new_record(config, "", workers)
    for name in ("config", "files", "version", "workers"):
        _check_equal(record[name], requested[name], name, out)
    _check_can_be_extended(record, config, out)


def _check_equal(recorded: Any, requested: Any, name: str, out: Path) -> None:
    """Compare two values, or the entries of two mappings in the order of their names."""
    if isinstance(recorded, Mapping) and isinstance(requested, Mapping):
        for key in sorted(set(recorded) | set(requested)):
            _check_equal(recorded.get(key), requested.get(key), f"{name}.{key}", out)
    elif recorded != requested and name != "config.ppo.total_steps":
        raise ValueError(
            f"{out} holds another training, with {name} = {brief(recorded)}, not "
            f"{brief(requested)}: use another folder"
        )


def _check_can_be_extended(record: Record, config: TrainingConfig, out: Path) -> None:
    steps, total_steps = [row["steps"] for row in record["rows"]], config.ppo.total_steps
    if len(steps) < 2 or steps[-1] >= total_steps:
        return
    if steps[-1] - steps[-2] < config.ppo.segment_steps:
        raise ValueError(
            f"{out} ended after {steps[-1]} steps with a shortened segment: it cannot be extended "
            f"to {total_steps}; use another folder"
        )


def add_row(
    record: Record,
    steps: int,
    n_robots: int,
    report: SegmentReport,
    scores: Mapping[str, float],
    validation_seconds: float,
) -> None:
    """Add the row of a segment, or of the initial network."""
    record["rows"].append(
        {
            "steps": steps,
            "team_return": n_robots * float(np.mean(report.returns)) if report.returns else None,
            "validation": dict(scores),
            "validation_seconds": validation_seconds,
            "seconds": report.seconds,
            "environment_seconds": report.environment_seconds,
            "collecting_seconds": report.collecting_seconds,
        }
    )


def progress_line(record: Record) -> str:
    """Progress after a segment: steps, validation scores, remaining time."""
    total_steps = record["config"]["ppo"]["total_steps"]
    row, best = record["rows"][-1], record["rows"][record["best"]]
    elapsed = _column_sum(record, "seconds") + _column_sum(record, "validation_seconds")
    left = max(total_steps - row["steps"], 0) * elapsed / max(row["steps"], 1)
    return (
        f"{row['steps']:>9,} of {total_steps:,} steps   "
        f"validation: reward {row['validation']['reward']:.4f} "
        f"(best {best['validation']['reward']:.4f}), area under the coverage curve "
        f"{100 * row['validation']['coverage_auc']:.2f} %"
        + (f"   about {left / 60:.0f} min left" if row["steps"] else "")
    )


def throughput_line(record: Record) -> str:
    """Speed of a training and the parts of its time, without validation."""
    seconds, environment, collecting = (
        _column_sum(record, name)
        for name in ("seconds", "environment_seconds", "collecting_seconds")
    )
    network = collecting - environment
    return (
        f"{record['rows'][-1]['steps'] / seconds:,.0f} agent-steps/s: environment "
        f"{environment / seconds:.0%}, network while collecting {network / seconds:.0%}, updates "
        f"{1 - collecting / seconds:.0%}"
    )


def config_to_dict(config: TrainingConfig) -> dict[str, Any]:
    """All of a configuration as JSON values."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(config)))
    return values


def _file_hashes(config: TrainingConfig) -> dict[str, str]:
    """Hashes of all files that a configuration names: scenes, and policies to start from."""
    policies = f"{config.imitate}:{config.init_from}"
    return file_hashes(policies, str(config.env.arguments.get("scene", "")), config.env.name)


def _recorded_workers(config: TrainingConfig, workers: int) -> int | None:
    """Number of processes, where the result depends on it."""
    return workers if config.engine == "rllib" else None


def _column_sum(record: Record, name: str) -> float:
    return float(sum(row[name] for row in record["rows"]))
