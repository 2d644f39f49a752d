"""What training.json says of a training: its plan, its machine, and one row for every segment."""

from __future__ import annotations

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

import coopmap_env

from .segments import SegmentReport
from .settings import Plan

RECORD = "training.json"

Record = dict[str, Any]
"""JSON values."""


def new_record(plan: Plan, command: str) -> Record:
    """Begin a record."""
    return {
        "version": coopmap_env.__version__,
        "command": command,
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "plan": as_json(plan),
        "imitation": None,
        "rows": [],
        "best": None,
        "checkpoint": "",
    }


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
        if record["rows"] is None or record["plan"] is None:
            raise KeyError("rows")
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is broken ({error!r}): remove its folder to begin anew"
        ) from error
    return record


def check_same(record: Record, plan: Plan, out: Path) -> None:
    """Refuse to go on with another training; only its length may differ.

    Raises
    ------
    ValueError
        With the first thing that differs.
    """
    was, now = _flat(record["plan"]), _flat(as_json(plan))
    was["version"], now["version"] = record["version"], coopmap_env.__version__
    for key in sorted(set(was) | set(now)):
        if key != "settings.total_steps" and was.get(key) != now.get(key):
            raise ValueError(
                f"{out} holds another training, with {key} = {was.get(key)!r}, not "
                f"{now.get(key)!r}: use another folder"
            )


def add_row(record: Record, steps: int, report: SegmentReport, scores: Mapping[str, float]) -> None:
    """Add the row of a segment."""
    record["rows"].append(
        {
            "steps": steps,
            "return": float(np.mean(report.returns)) if report.returns else None,
            "validation": dict(scores),
            "seconds": report.seconds,
            "environment_seconds": report.environment_seconds,
            "collecting_seconds": report.collecting_seconds,
        }
    )


def progress_line(record: Record) -> str:
    """What a training says after a segment."""
    wanted = record["plan"]["settings"]["total_steps"]
    row, best = record["rows"][-1], record["rows"][record["best"]]
    left = (wanted - row["steps"]) / (row["steps"] / _total(record, "seconds"))
    return (
        f"{row['steps']:>9,} of {wanted:,} steps   "
        f"validation: reward {row['validation']['reward']:.4f} "
        f"(best {best['validation']['reward']:.4f}), area under the coverage curve "
        f"{100 * row['validation']['coverage_auc']:.2f} %   about {left / 60:.0f} min left"
    )


def throughput_line(record: Record) -> str:
    """How fast a training was, and what its time went into; validation is not counted."""
    seconds, environment, collecting = (
        _total(record, name) for name in ("seconds", "environment_seconds", "collecting_seconds")
    )
    network = collecting - environment
    return (
        f"{record['rows'][-1]['steps'] / seconds:,.0f} agent-steps/s: environment "
        f"{environment / seconds:.0%}, network while collecting {network / seconds:.0%}, updates "
        f"{1 - collecting / seconds:.0%}"
    )


def as_json(plan: Plan) -> dict[str, Any]:
    """All of a plan as JSON values."""
    values: dict[str, Any] = json.loads(json.dumps(asdict(plan)))
    return values


def _total(record: Record, name: str) -> float:
    return float(sum(row[name] for row in record["rows"]))


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{before}{key}"
        flat.update(_flat(value, f"{name}.") if isinstance(value, dict) else {name: value})
    return flat
