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
        settings_from_dict(record["config"], MapTrainingConfig)
        for row in record["rows"]:
            settings_from_dict(row, SegmentRow)
            for scores in row["validation"].values():
                PredictionScores(**scores)
        if record["rows"] and record["best"] not in range(len(record["rows"])):
            raise ValueError(f"best is {brief(record['best'])}, of {len(record['rows'])} rows")
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise FileError(
            f"{path} is broken ({error!s:.300}): remove its folder to start again"
        ) from error
    return record


def check_same_training(record: Record, config: MapTrainingConfig, out: Path) -> None:
    """Check that a record is of this training.

    Raises
    ------
    ValueError
        With the first difference.
    """
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
