"""A training with files: progress, checkpoints, validation, and going on after an interruption.

::

    out/training.json        all about it: task, settings, seed, and one row for every segment
    out/checkpoint-*.pt      what the next segment depends on, of the last one
    out/policy.safetensors   the policy that did best on validation worlds
    out/tensorboard/         logs

After each segment the checkpoint is written first and training.json last, so that what it says is
always there. Who does the learning is an `Trainer`: Stable-Baselines3, or RLlib on Ray.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any, Protocol

from coopmap_agents import RL_EXTRA_HINT

from coopmap_env.core.files import write_atomically
from coopmap_env.envs.mapping_env import MappingEnv
from coopmap_env.evaluation import evaluate
from coopmap_env.evaluation.policy import make_policy

try:
    import torch
    from stable_baselines3.common.policies import ActorCriticPolicy
except ImportError as error:
    raise ImportError(RL_EXTRA_HINT) from error

from coopmap_agents.networks.networks import copy_weights
from coopmap_agents.plan import TrainingConfig
from coopmap_agents.pretrained.learned_policy import LearnedPolicy, resolve_network
from coopmap_agents.pretrained.policy_file import save_policy
from coopmap_agents.record import (
    POLICY_FILE,
    RECORD_FILE,
    Record,
    add_row,
    check_same_training,
    config_to_dict,
    new_record,
    progress_line,
    read_record,
)
from coopmap_agents.training.imitation import behavior_clone
from coopmap_agents.training.segments import SegmentReport, load_checkpoint, save_checkpoint

SCORES = ("coverage_auc", "coverage", "reward", "log_loss", "motion_cost")
"""Of `Episode.row`, averaged over the validation worlds."""


class Trainer(Protocol):
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


def run_training(
    config: TrainingConfig,
    out: Path,
    workers: int = 0,
    log: Callable[[str], None] = lambda line: None,
    command: str = "",
) -> dict[str, Any]:
    """Train, or go on with the training of a folder; gives what is in training.json.

    Parameters
    ----------
    config : TrainingConfig
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
    record = read_record(out / RECORD_FILE) or new_record(config, command, workers)
    check_same_training(record, config, workers, out)
    if record["rows"] and record["rows"][-1]["steps"] >= config.ppo.total_steps:
        log(f"{out} is finished: {record['rows'][-1]['steps']:,} steps")
        return record
    record["config"] = config_to_dict(config)  # total_steps may have grown
    with _single_thread(), _trainer(config, workers, out / "tensorboard") as trainer:
        if record["rows"]:
            trainer.steps = load_checkpoint(out / record["checkpoint"], trainer.network)
        else:
            _initialize_weights(config, trainer, record)
        with closing(config.env.make("validation")) as validation:
            if not record["rows"]:
                _validate(config, trainer, record, validation, out, log)
            while trainer.steps < config.ppo.total_steps:
                trainer.learn(len(record["rows"]) - 1)
                _validate(config, trainer, record, validation, out, log)
    return record


@contextmanager
def _single_thread() -> Iterator[None]:
    """One thread of torch: more of them round sums otherwise, and small networks gain little."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextmanager
def _trainer(config: TrainingConfig, workers: int, logs: Path) -> Iterator[Trainer]:
    _check_device(config.ppo.device)
    trainer: Trainer
    if config.engine == "rllib":
        from coopmap_agents.rllib.ppo import RLlibTrainer

        trainer = RLlibTrainer(config.env, config.ppo, config.seed, workers, logs)
    else:
        from coopmap_agents.sb3.ppo import SB3Trainer

        trainer = SB3Trainer(config.env, config.ppo, config.seed, workers, logs)
    try:
        yield trainer
    finally:
        trainer.close()


def _check_device(device: str) -> None:
    try:
        torch.zeros(1, device=device)
    except (RuntimeError, AssertionError) as error:  # torch asserts that it was built with CUDA
        raise ValueError(f"PPOSettings.device {device!r} is not there: {error}") from error


def _initialize_weights(config: TrainingConfig, trainer: Trainer, record: Record) -> None:
    """Take over the weights that the plan names, and imitate its teacher."""
    if config.init_from:
        copy_weights(resolve_network(config.init_from), trainer.network)
    if config.expert:
        started_at = time.perf_counter()
        expert = make_policy(config.expert)
        report = behavior_clone(trainer.network, config.env, expert, config.imitation, config.seed)
        record["imitation"] = {**asdict(report), "seconds": time.perf_counter() - started_at}


def _validate(
    config: TrainingConfig,
    trainer: Trainer,
    record: Record,
    validation: MappingEnv[Any],
    out: Path,
    log: Callable[[str], None],
) -> None:
    """Let the policy play validation worlds, and write all files."""
    started_at = time.perf_counter()
    evaluation = evaluate(
        validation, LearnedPolicy(trainer.network), range(config.validation_episodes)
    )
    scores = {name: float(evaluation.table[name].mean()) for name in SCORES}
    n_robots = len(validation.possible_agents)
    seconds = time.perf_counter() - started_at
    report = trainer.report
    add_row(record, trainer.steps, n_robots, report, scores, seconds)
    trainer.log({f"validation/{name}": value for name, value in scores.items()})
    if report.returns:
        trainer.log({"train/team_return": record["rows"][-1]["team_return"]})
    _write(record, trainer, config, out)
    log(progress_line(record))


def _write(record: Record, trainer: Trainer, config: TrainingConfig, out: Path) -> None:
    """Write the checkpoint, the policy if it is the best one so far, and then the record."""
    out.mkdir(parents=True, exist_ok=True)
    rows, before = record["rows"], record["checkpoint"]
    record["checkpoint"] = f"checkpoint-{len(rows)}.pt"
    save_checkpoint(out / record["checkpoint"], trainer.network, trainer.steps)
    rewards = [row["validation"]["reward"] for row in rows]
    if rewards[-1] == max(rewards):
        record["best"] = len(rows) - 1
        origin = {
            "config": record["config"],
            "steps": trainer.steps,
            "validation": rows[-1]["validation"],
        }
        save_policy(trainer.network, config.ppo, out / POLICY_FILE, origin)
    write_atomically(out / RECORD_FILE, json.dumps(record, indent=1) + "\n")
    if before and before != record["checkpoint"]:
        (out / before).unlink(missing_ok=True)
