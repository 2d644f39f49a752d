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
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from coopmap_agents import NEEDS_RL

from coopmap_env.core.files import write_atomically
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.policy import make_policy

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(NEEDS_RL) from error

from coopmap_agents.networks.networks import copy_weights
from coopmap_agents.plan import Plan
from coopmap_agents.pretrained.learned_policy import LearnedPolicy, network_of
from coopmap_agents.pretrained.policy_file import save_policy
from coopmap_agents.record import (
    POLICY,
    RECORD,
    Record,
    add_row,
    as_json,
    check_same,
    new_record,
    progress_line,
    read_record,
)
from coopmap_agents.training.imitation import clone
from coopmap_agents.training.segments import SegmentReport, restore_checkpoint, save_checkpoint

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
        Processes for the environments. With Stable-Baselines3 the result does not depend on it;
        with RLlib it does, and the folder can be gone on with by as many only.
    say : callable, optional
        Gets a line before the first and after each segment.
    command : str, optional
        What asked for the training, for the record.

    Raises
    ------
    ValueError
        If the folder holds another training or broken files, or the plan names a device that is not
        there or weights of another network.
    """
    record = read_record(out / RECORD) or new_record(plan, command, workers)
    check_same(record, plan, workers, out)
    if record["rows"] and record["rows"][-1]["steps"] >= plan.settings.total_steps:
        say(f"{out} is finished: {record['rows'][-1]['steps']:,} steps")
        return record
    record["plan"] = as_json(plan)  # total_steps may have grown
    with _one_thread(), _engine(plan, workers, out / "tensorboard") as engine:
        if record["rows"]:
            engine.steps = restore_checkpoint(out / record["checkpoint"], engine.network)
        else:
            _begin(plan, engine, record)
        with closing(plan.task.on("validation")) as validation:
            if not record["rows"]:
                _judge(plan, engine, record, validation, out, say)
            while engine.steps < plan.settings.total_steps:
                engine.learn(len(record["rows"]) - 1)
                _judge(plan, engine, record, validation, out, say)
    return record


@contextmanager
def _one_thread() -> Iterator[None]:
    """One thread of torch: more of them round sums otherwise, and small networks gain little."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _engine(plan: Plan, workers: int, logs: Path) -> Iterator[Engine]:
    _require_device(plan.settings.device)
    engine: Engine
    if plan.engine == "rllib":
        from coopmap_agents.rllib.ppo import RLlibTraining

        engine = RLlibTraining(plan.task, plan.settings, plan.seed, workers, logs)
    else:
        from coopmap_agents.sb3.ppo import PPOTraining

        engine = PPOTraining(plan.task, plan.settings, plan.seed, workers, logs)
    try:
        yield engine
    finally:
        engine.close()


def _require_device(device: str) -> None:
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:  # torch asserts that it was built with CUDA
        raise ValueError(f"PPOSettings.device {device!r} is not there: {error}") from error


def _begin(plan: Plan, engine: Engine, record: Record) -> None:
    """Take over the weights that the plan names, and imitate its teacher."""
    if plan.begin_with:
        copy_weights(network_of(plan.begin_with), engine.network)
    if plan.teacher:
        began = time.perf_counter()
        teacher = make_policy(plan.teacher)
        report = clone(engine.network, plan.task, teacher, plan.imitation, plan.seed)
        record["imitation"] = {**asdict(report), "seconds": time.perf_counter() - began}


def _judge(
    plan: Plan,
    engine: Engine,
    record: Record,
    validation: MappingEnv[Any],
    out: Path,
    say: Callable[[str], None],
) -> None:
    """Let the policy play validation worlds, and write all files."""
    began = time.perf_counter()
    played = evaluate(validation, LearnedPolicy(engine.network), range(plan.validation_episodes))
    scores = {name: float(played.table[name].mean()) for name in SCORES}
    n_robots = len(validation.possible_agents)
    seconds = time.perf_counter() - began
    report = engine.report
    add_row(record, engine.steps, n_robots, report, scores, seconds)
    engine.log({f"validation/{name}": value for name, value in scores.items()})
    if report.returns:
        engine.log({"train/team_return": record["rows"][-1]["team_return"]})
    _write(record, engine, plan, out)
    say(progress_line(record))


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
