"""What a training.json has to hold: the types of its values, and how they belong together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any

from coopmap_agents.config import TrainingConfig
from coopmap_env.core.files import brief
from coopmap_env.core.settings import NonNegative, NonNegativeInt, Settings, settings_from_dict


@dataclass(frozen=True)
class ValidationScores(Settings):
    """Means over the validation worlds, of columns of an evaluation's table."""

    coverage_auc: float
    coverage: float
    reward: float
    log_loss: float
    motion_distance: float


@dataclass(frozen=True)
class SegmentRow(Settings):
    """A segment, or the network before the first one; durations are in seconds."""

    steps: NonNegativeInt
    team_return: float | None
    validation: ValidationScores
    validation_seconds: NonNegative
    seconds: NonNegative
    environment_seconds: NonNegative
    collecting_seconds: NonNegative


@dataclass(frozen=True)
class ImitationRow(Settings):
    """The imitation before the training; see `ImitationReport`."""

    n_train: NonNegativeInt
    n_held_out: NonNegativeInt
    agreement: float
    log_likelihood: float
    seconds: NonNegative


@dataclass(frozen=True)
class TrainingRecord(Settings):
    """All of a training.json after at least one row.

    Raises
    ------
    ValueError
        With the field, if a value is not as described.
    """

    version: str
    command: str
    machine: str
    config: TrainingConfig
    files: Mapping[str, Any]
    """SHA-256 of files, by path."""
    workers: NonNegativeInt | None
    imitation: ImitationRow | None
    rows: tuple[SegmentRow, ...]
    """The first is of the network before training; steps increase from 0."""
    best: NonNegativeInt
    """Index of the row with the largest reward in validation."""
    checkpoint: str
    """Always `checkpoint_name`: no record can name another file."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not isinstance(self.files, Mapping):
            raise ValueError(f"files must be hashes by path, got {brief(self.files)}")
        steps = [row.steps for row in self.rows]
        if not steps or steps[0] != 0 or any(a >= b for a, b in pairwise(steps)):
            raise ValueError(f"the steps of rows must increase from 0, got {brief(steps)}")
        if not all(row.seconds > 0 for row in self.rows[1:]):
            raise ValueError("the seconds of a segment must be above 0")
        rewards = [row.validation.reward for row in self.rows]
        if self.best >= len(rewards) or rewards[self.best] != max(rewards):
            raise ValueError(
                f"best must be the index of the row with the largest reward, got {self.best}"
            )
        if self.checkpoint != checkpoint_name(len(self.rows)):
            raise ValueError(
                f"checkpoint must be {checkpoint_name(len(self.rows))} after {len(self.rows)} "
                f"rows, got {brief(self.checkpoint)}"
            )


def checkpoint_name(n_rows: int) -> str:
    """Name of the checkpoint after this number of rows, in the folder of its training."""
    return f"checkpoint-{n_rows}.pt"


def check_record(values: Any) -> None:
    """Check the JSON values of a record.

    Raises
    ------
    ValueError
        With the row or field that is not as described in `TrainingRecord`.
    """
    if not isinstance(values, Mapping):
        raise ValueError(f"expected a JSON object, got {brief(values)}")
    if missing := sorted({field.name for field in fields(TrainingRecord)} - set(values)):
        raise ValueError(f"without {missing}")
    settings_from_dict({**values, "rows": _typed_rows(values["rows"])}, TrainingRecord)


def check_pretrained_record(values: Any) -> None:
    """Check the JSON values of the record of a pretrained policy, which `export` writes.

    Raises
    ------
    ValueError
        With what is not as described.
    """
    seeds, trainings = (
        (values.get("seeds"), values.get("trainings")) if isinstance(values, Mapping) else (0, 0)
    )
    if not isinstance(seeds, list) or not all(type(seed) is int for seed in seeds):
        raise ValueError(f"seeds must be integers, got {brief(seeds)}")
    if type(values["best_seed"]) is not int or values["best_seed"] not in seeds:
        raise ValueError(f"best_seed must be one of {seeds}, got {brief(values['best_seed'])}")
    if not isinstance(trainings, Mapping) or set(trainings) != set(map(str, seeds)):
        raise ValueError(f"trainings must be of the seeds {seeds}, got {brief(trainings)}")
    for seed, training in trainings.items():
        rows = _typed_rows(training["rows"], validation_seconds=0.0)  # older records have none
        best_row = training["best_row"]
        if type(best_row) is not int or not 0 <= best_row < len(rows):
            raise ValueError(f"seed {seed}: best_row must be a row, got {brief(best_row)}")


def _typed_rows(rows: Any, **defaults: Any) -> tuple[SegmentRow, ...]:
    if not isinstance(rows, list):
        raise ValueError(f"rows must be a list, got {brief(rows)}")
    typed_rows = []
    for k, row in enumerate(rows):
        try:
            given = {**defaults, **row} if isinstance(row, Mapping) else row
            typed_rows.append(settings_from_dict(given, SegmentRow))
        except ValueError as error:
            raise ValueError(f"row {k}: {error}") from error
    return tuple(typed_rows)
