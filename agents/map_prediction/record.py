"""The record of a training of a map network, training.json."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_agents.map_config import MapTrainingConfig
from coopmap_agents.map_prediction.scores import PredictionScores
from coopmap_agents.record import RECORD_FILE, Record, machine_description
from coopmap_env.core.files import FileError, brief, read_json
from coopmap_env.core.settings import (
    NonNegative,
    PositiveInt,
    Settings,
    settings_from_dict,
    settings_to_dict,
)
from coopmap_env.core.version import __version__


@dataclass(frozen=True)
class SegmentRow(Settings):
    """A segment of a training."""

    steps: PositiveInt
    loss: NonNegative
    """Mean over its batches, nats."""
    seconds: NonNegative
    validation: dict[str, Any]
    """`PredictionScores` by family and scene."""


def new_record(config: MapTrainingConfig, command: str) -> Record:
    """Record of a training that has not started."""
    return {
        "version": __version__,
        "command": command,
        "machine": machine_description(),
        "config": json.loads(json.dumps(settings_to_dict(config))),
        "rows": [],
        "best": None,
    }


def read_record(folder: Path) -> Record | None:
    """Read the record of a training's folder; None if it has none.

    Those of other versions, and of policies, are not checked any further: `check_same_training`
    refuses them.

    Raises
    ------
    FileError
        If the file is broken.
    """
    path = folder / RECORD_FILE
    if not os.path.lexists(path):
        return None
    try:
        record: Record = read_json(path)
        if not isinstance(record, dict) or not isinstance(record.get("version"), str):
            raise ValueError("it has no version")
    except (ValueError, RecursionError) as error:
        raise _broken(path, error) from error
    if record["version"] == __version__ and "engine" not in _config_of(record):
        try:
            _check_form(record)
        except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
            raise _broken(path, error) from error
    return record


def _broken(path: Path, error: Exception) -> FileError:
    reason = str(error).removeprefix(f"{path}: ")
    return FileError(f"{path} is broken ({reason:.300}): remove its folder to start again")


def _config_of(record: Record) -> Any:
    config = record.get("config")
    return config if isinstance(config, dict) else {}


def _check_form(record: Record) -> None:
    """ValueError, or what odd values lead to, unless it is a record of a map network."""
    config = settings_from_dict(record["config"], MapTrainingConfig)
    rows, best = record["rows"], record["best"]
    if not isinstance(rows, list):
        raise ValueError(f"rows must be a list, got {brief(rows)}")
    for row in rows:
        settings_from_dict(row, SegmentRow)
        if sorted(row["validation"]) != sorted(config.worlds):
            raise ValueError(f"validation is of {brief(sorted(row['validation']))}")
        for scores in row["validation"].values():
            settings_from_dict(scores, PredictionScores)
    if best is not None if not rows else type(best) is not int or not 0 <= best < len(rows):
        raise ValueError(f"best is {brief(best)}, of {len(rows)} rows")


def check_same_training(record: Record, config: MapTrainingConfig, out: Path) -> None:
    """Check that a record is of this training.

    Raises
    ------
    ValueError
        With the first difference.
    """
    if "engine" in _config_of(record):
        raise ValueError(f"{out} holds the training of a policy: use another folder")
    requested = new_record(config, "")
    if record["version"] != requested["version"]:
        raise ValueError(
            f"{out} holds a training by coopmap {brief(record['version'])}, this is "
            f"{requested['version']}: use another folder"
        )
    for name, value in requested["config"].items():
        if record["config"].get(name) != value:
            raise ValueError(
                f"{out} holds another training, with {name} = {brief(record['config'].get(name))}, "
                f"not {brief(value)}: use another folder"
            )


def mean_log_loss(row: dict[str, Any]) -> float:
    """Mean log loss over the families and scenes of a row."""
    return float(np.mean([scores["log_loss"] for scores in row["validation"].values()]))


def progress_line(record: Record) -> str:
    """Progress after a segment: steps, log loss on validation worlds, remaining time."""
    rows, total_steps = record["rows"], record["config"]["total_steps"]
    row, best = rows[-1], rows[record["best"]]
    left = (total_steps - row["steps"]) * sum(one["seconds"] for one in rows) / row["steps"]
    return (
        f"{row['steps']:>6,} of {total_steps:,} steps   log loss {row['loss']:.4f}, on validation "
        f"worlds {mean_log_loss(row):.4f} (best {mean_log_loss(best):.4f})"
        + (f"   about {left / 60:.0f} min left" if left else "")
    )
