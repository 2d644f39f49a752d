"""A training with files: progress, checkpoints, validation, and going on after an interruption.

::

    out/training.json        all about it: task, settings, seed, and one row for every segment
    out/checkpoint-*.pt      what the next segment depends on, of the last one
    out/policy.safetensors   the policy that did best on validation worlds
    out/tensorboard/         logs

After each segment the checkpoint is written first and training.json last, so that what it says is
always there. Who does the learning is an `Engine`: Stable-Baselines3, or RLlib on Ray.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.jobs import write_atomically
from coopmap_env.evaluation.policy import make_policy

from . import NEEDS_RL

try:
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from .imitation import clone
from .learned_policy import LearnedPolicy
from .policy_file import save_policy
from .segments import SegmentReport, restore_checkpoint, save_checkpoint
from .settings import Plan
from .training_record import (
    RECORD,
    Record,
    add_row,
    as_json,
    check_same,
    new_record,
    progress_line,
    read_record,
)

POLICY = "policy.safetensors"
SCORES = ("coverage_auc", "coverage", "reward", "log_loss", "motion_cost")
"""Of `Episode.row`, averaged over the validation worlds."""


class Engine(Protocol):
    """Who learns, segment by segment."""

    report: SegmentReport
    """Of the last one."""
    steps: int
    """That were learned from."""

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic themselves: who changes their weights changes what is learned on."""

    def learn(self, segment: int) -> bool:
        """Learn for one segment."""

    def log(self, scores: dict[str, float]) -> None:
        """Write scores to TensorBoard."""

    def close(self) -> None:
        """Close everything."""


def train_with_files(
    plan: Plan,
    out: Path,
    workers: int = 0,
    say: Callable[[str], None] = lambda line: None,
    command: str = "",
) -> dict[str, Any]:
    """Train, or go on with the training of a folder; gives what is in training.json.

    Parameters
    ----------
    plan : Plan
    out : Path
        Folder; one that holds the same training, finished or not, is gone on with.
    workers : int
        Processes for the environments; the result does not depend on it with Stable-Baselines3.
    say : callable, optional
        Gets a line after each segment.
    command : str, optional
        What asked for the training, for the record.

    Raises
    ------
    ValueError
        If the folder holds another training, or its files are broken.
    """
    record = read_record(out / RECORD) or new_record(plan, command)
    check_same(record, plan, out)
    if record["rows"] and record["rows"][-1]["steps"] >= plan.settings.total_steps:
        return record
    record["plan"] = as_json(plan)  # total_steps may have grown
    engine = _engine(plan, workers, out / "tensorboard")
    validation = plan.task.on("validation")
    try:
        if record["rows"]:
            engine.steps = restore_checkpoint(out / record["checkpoint"], engine.network)
        elif plan.teacher:
            record["imitation"] = _imitate(plan, engine)
        while engine.steps < plan.settings.total_steps:
            segment = len(record["rows"])
            engine.learn(segment)
            scores = _validate(validation, engine.network, plan.validation_episodes)
            add_row(record, engine.steps, engine.report, scores)
            engine.log({f"validation/{name}": value for name, value in scores.items()})
            _write(record, engine, plan, out)
            say(progress_line(record))
    finally:
        validation.close()
        engine.close()
    return record


def _engine(plan: Plan, workers: int, logs: Path) -> Engine:
    if plan.engine == "rllib":
        from .rllib import RLlibTraining

        return RLlibTraining(plan.task, plan.settings, plan.seed, workers, logs)
    from .ppo import PPOTraining

    return PPOTraining(plan.task, plan.settings, plan.seed, workers, logs)


def _imitate(plan: Plan, engine: Engine) -> dict[str, Any]:
    began = time.perf_counter()
    teacher = make_policy(plan.teacher)
    report = clone(engine.network, plan.task, teacher, plan.imitation, plan.seed)
    return {**asdict(report), "seconds": time.perf_counter() - began}


def _validate(env: Any, network: ActorCriticPolicy, episodes: int) -> dict[str, float]:
    table = evaluate(env, LearnedPolicy(network), range(episodes)).table
    return {name: float(table[name].mean()) for name in SCORES}


def _write(record: Record, engine: Engine, plan: Plan, out: Path) -> None:
    """Write the checkpoint, the policy if it is the best one so far, and then the record."""
    out.mkdir(parents=True, exist_ok=True)
    rows, before = record["rows"], record["checkpoint"]
    record["checkpoint"] = f"checkpoint-{len(rows)}.pt"
    save_checkpoint(out / record["checkpoint"], engine.network, engine.steps)
    rewards = [row["validation"]["reward"] for row in rows]
    if rewards[-1] == max(rewards):
        record["best"] = len(rows) - 1
        said = {"plan": record["plan"], "steps": engine.steps, "validation": rows[-1]["validation"]}
        save_policy(engine.network, plan.settings, out / POLICY, said)
    write_atomically(out / RECORD, json.dumps(record, indent=1) + "\n")
    if before and before != record["checkpoint"]:
        (out / before).unlink(missing_ok=True)
