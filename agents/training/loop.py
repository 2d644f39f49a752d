"""A training in a folder: checkpoints, validation, and resuming after an interruption.

::

    out/training.json        the record: configuration, and one row for every segment
    out/checkpoint-*.pt      what the next segment depends on, after the last one
    out/policy.safetensors   the policy with the largest reward on validation worlds
    out/policy.onnx          the same, for acting without torch
    out/tensorboard/         logs

A training is a chain of segments. Each depends only on the weights before it and on its number, so
a resumed training has the same result as an uninterrupted one. After each segment the checkpoint is
written first and training.json last: every file that training.json names exists.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import torch

from coopmap_agents._record_form import checkpoint_name
from coopmap_agents.config import TrainingConfig
from coopmap_agents.networks import copy_weights
from coopmap_agents.ppo import PPOTrainer
from coopmap_agents.pretrained import LearnedPolicy, resolve_network, save_policy
from coopmap_agents.record import (
    ONNX_FILE,
    POLICY_FILE,
    RECORD_FILE,
    VALIDATION_SCORES,
    Record,
    add_row,
    check_same_training,
    config_to_dict,
    new_record,
    progress_line,
    read_record,
)
from coopmap_agents.sb3 import SB3Trainer
from coopmap_agents.trainer import Trainer, torch_threads
from coopmap_agents.training.checkpoints import (
    load_checkpoint,
    remove_other_checkpoints,
    save_checkpoint,
)
from coopmap_agents.training.imitation import behavior_clone
from coopmap_env.core.files import write_atomically
from coopmap_env.core.locks import folder_lock
from coopmap_env.envs import MappingEnv
from coopmap_env.evaluation import evaluate, make_policy


def run_training(
    config: TrainingConfig,
    out: Path,
    workers: int = 0,
    log: Callable[[str], None] = lambda line: None,
    command: str = "",
) -> Record:
    """Train, or resume the training of a folder; gives the content of training.json.

    Parameters
    ----------
    config : TrainingConfig
    out : Path
        Folder. If it holds this training, that is resumed.
    workers : int
        Processes for the environments. The result does not depend on it, except with RLlib: there
        a training must be resumed with the same number.
    log : callable, optional
        Called with a line of progress before the first and after each segment.
    command : str, optional
        Command line of the training, for the record.

    Raises
    ------
    ValueError
        If the folder holds another training, or the configuration names a missing device or weights
        of another network.
    FileError
        If the folder holds broken files; the message says what to do. No record can name a file
        outside of its folder.
    FolderInUseError
        If another process trains in the folder.
    WorkerError
        If a worker was killed. The same call continues after the last segment.
    """
    with folder_lock(out):
        return _train(config, out, workers, log, command)


def _train(
    config: TrainingConfig, out: Path, workers: int, log: Callable[[str], None], command: str
) -> Record:
    record = read_record(out) or new_record(config, command, workers)
    check_same_training(record, config, workers, out)
    remove_other_checkpoints(out, len(record["rows"]))
    if record["rows"] and record["rows"][-1]["steps"] >= config.ppo.total_steps:
        log(f"{out} is finished: {record['rows'][-1]['steps']:,} steps")
        return record
    record["config"] = config_to_dict(config)  # total_steps may be larger than before
    logs = out / "tensorboard"
    with (
        torch_threads(config.ppo.threads),
        closing(_make_trainer(config, workers, logs)) as trainer,
    ):
        if record["rows"]:
            trainer.steps = load_checkpoint(
                out / record["checkpoint"],
                trainer.network,
                trainer.network.optimizer,
                record["rows"][-1]["steps"],
            )
        else:
            record["imitation"] = _initialize_network(trainer, config)
        with closing(config.env.make("validation")) as validation:
            finisher = _SegmentFinisher(config, out, record, validation, log)
            if not record["rows"]:
                finisher.finish_segment(trainer)
            while trainer.steps < config.ppo.total_steps:
                # the first row is of the network before training, so that row k + 1 is of segment k
                trainer.learn(len(record["rows"]) - 1)
                finisher.finish_segment(trainer)
    return record


def _make_trainer(config: TrainingConfig, workers: int, logs: Path) -> Trainer:
    try:
        torch.zeros(1, device=config.ppo.device)
    except (RuntimeError, AssertionError) as error:  # torch asserts that it was built with CUDA
        raise ValueError(
            f"PPOSettings.device {config.ppo.device!r} is not available: {error}"
        ) from error
    if config.engine == "rllib":
        from coopmap_agents.rllib import RLlibTrainer

        return RLlibTrainer(config.env, config.ppo, config.seed, workers, logs)
    trainer = PPOTrainer if config.engine == "ppo" else SB3Trainer
    return trainer(config.env, config.ppo, config.seed, workers, logs)


def _initialize_network(trainer: Trainer, config: TrainingConfig) -> dict[str, float] | None:
    """Copy the weights of `init_from`, imitate the policy `imitate`; the report of the latter."""
    if config.init_from:
        copy_weights(resolve_network(config.init_from), trainer.network)
    if not config.imitate:
        return None
    start = time.perf_counter()
    expert = make_policy(config.imitate)
    report = behavior_clone(trainer.network, config.env, expert, config.imitation, config.seed)
    return {**asdict(report), "seconds": time.perf_counter() - start}


@dataclass(frozen=True)
class _SegmentFinisher:
    """Validates the network and writes all files: before the first segment and after each."""

    config: TrainingConfig
    out: Path
    record: Record
    validation: MappingEnv[Any]
    log: Callable[[str], None]

    def finish_segment(self, trainer: Trainer) -> None:
        """Evaluate the network on the validation worlds, and write all files."""
        self._validate(trainer)
        self._write(trainer)
        self.log(progress_line(self.record))

    def _validate(self, trainer: Trainer) -> None:
        """Add the scores of the network to the record and to the logs."""
        start = time.perf_counter()
        seeds = range(self.config.validation_episodes)
        table = evaluate(self.validation, LearnedPolicy(trainer.network), seeds).table
        scores = {name: float(table[name].mean()) for name in VALIDATION_SCORES}
        seconds = time.perf_counter() - start
        n_robots = len(self.validation.possible_agents)
        add_row(self.record, trainer.steps, n_robots, trainer.report, scores, seconds)
        trainer.log({f"validation/{name}": value for name, value in scores.items()})
        if trainer.report.returns:
            trainer.log({"train/team_return": self.record["rows"][-1]["team_return"]})

    def _write(self, trainer: Trainer) -> None:
        """Write the checkpoint, the policy if it is the best so far, and last the record."""
        record, rows = self.record, self.record["rows"]
        self.out.mkdir(parents=True, exist_ok=True)
        record["checkpoint"] = checkpoint_name(len(rows))
        network = trainer.network
        save_checkpoint(self.out / record["checkpoint"], network, network.optimizer, trainer.steps)
        rewards = [row["validation"]["reward"] for row in rows]
        if rewards[-1] == max(rewards):
            record["best"] = len(rows) - 1
            origin = {
                "config": record["config"],
                "steps": trainer.steps,
                "validation": rows[-1]["validation"],
            }
            for name in (POLICY_FILE, ONNX_FILE):
                save_policy(trainer.network, self.config.ppo, self.out / name, origin)
        write_atomically(self.out / RECORD_FILE, json.dumps(record, indent=1) + "\n")
        remove_other_checkpoints(self.out, len(rows))
