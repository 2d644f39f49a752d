"""What training.json says of a training: its config, its machine, and one row for every segment."""

from __future__ import annotations

import json
import os
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from coopmap_agents.plan import TrainingConfig

from coopmap_env.core.version import __version__
from coopmap_env.evaluation.comparison import file_hashes

if TYPE_CHECKING:
    from coopmap_agents.training.segments import SegmentReport

RECORD_FILE = "training.json"
POLICY_FILE = "policy.safetensors"

Record = dict[str, Any]
"""JSON values, under `RECORD_KEYS`."""
RECORD_KEYS = {
    "version", "command", "machine", "config", "files", "workers", "imitation", "rows", "best",
    "checkpoint",
}  # fmt: skip


def new_record(config: TrainingConfig, command: str, workers: int) -> Record:
    """Begin a record."""
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
    """Processor, cores and versions: what the time depends on, and the last bits of the weights."""
    return (
        f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores, "
        f"Python {platform.python_version()}, torch {version('torch')}"
    )


def read_record(path: Path) -> Record | None:
    """Read the record of a folder, if it has one.

    Raises
    ------
    ValueError
        If it is broken.
    """
    if not path.exists():
        return None
    try:
        record: Record = json.loads(path.read_text(encoding="utf-8"))
        missing = sorted(RECORD_KEYS - set(record))
        if missing:
            raise KeyError(*missing)
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is broken ({error!r}): remove its folder to begin anew"
        ) from error
    return record


def check_same_training(record: Record, config: TrainingConfig, workers: int, out: Path) -> None:
    """Refuse to go on with another training; only its length may differ.

    Raises
    ------
    ValueError
        With the first thing that differs, or if the last segment was cut short, so that a longer
        training would have gone another way.
    """
    was, now = (
        _flatten({name: recorded[name] for name in ("version", "config", "files", "workers")})
        for recorded in (record, new_record(config, "", workers))
    )
    for key in sorted(set(was) | set(now)):
        if key != "config.ppo.total_steps" and was.get(key) != now.get(key):
            raise ValueError(
                f"{out} holds another training, with {key} = {was.get(key)!r}, not "
                f"{now.get(key)!r}: use another folder"
            )
    _check_can_be_extended(record, config, out)


def _check_can_be_extended(record: Record, config: TrainingConfig, out: Path) -> None:
    steps, total_steps = [row["steps"] for row in record["rows"]], config.ppo.total_steps
    if len(steps) < 2 or steps[-1] >= total_steps:
        return
    if steps[-1] - steps[-2] < config.ppo.segment_steps:
        raise ValueError(
            f"{out} ended after {steps[-1]} steps with a segment that was cut short: it cannot be "
            f"lengthened to {total_steps}; use another folder"
        )


def add_row(
    record: Record,
    steps: int,
    n_robots: int,
    report: SegmentReport,
    scores: Mapping[str, float],
    validation_seconds: float,
) -> None:
    """Add the row of a segment, or of what there is before the first."""
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
    """What a training says after a segment."""
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
    """How fast a training was, and what its time went into; validation is not counted."""
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
    """All of a plan as JSON values."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(config)))
    return values


def _file_hashes(config: TrainingConfig) -> dict[str, str]:
    """Hashes of all files that a plan names: scenes, policies to begin with or to imitate."""
    env_config = config.env
    sources = f"{config.expert}:{config.init_from}"
    return file_hashes(sources, str(env_config.arguments.get("scene", "")), env_config.name)


def _recorded_workers(config: TrainingConfig, workers: int) -> int | None:
    """How many processes, where the result depends on it."""
    return workers if config.engine == "rllib" else None


def _column_sum(record: Record, name: str) -> float:
    return float(sum(row[name] for row in record["rows"]))


def _flatten(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{before}{key}"
        flat.update(_flatten(value, f"{name}.") if isinstance(value, dict) else {name: value})
    return flat
