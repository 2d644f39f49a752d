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
import platform
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol, get_args

import numpy as np

import coopmap_env
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
from .segments import SegmentReport
from .settings import EngineName, ImitationSettings, PPOSettings, Task

RECORD = "training.json"
POLICY = "policy.safetensors"
SCORES = ("coverage_auc", "coverage", "reward", "log_loss", "motion_cost")
"""Of `Episode.row`, averaged over the validation worlds."""


class Engine(Protocol):
    """Who learns, segment by segment."""

    report: SegmentReport

    @property
    def network(self) -> ActorCriticPolicy:
        """Actor and critic as they are now."""

    @property
    def steps(self) -> int:
        """Steps that were learned from."""

    def begin_with(self, network: ActorCriticPolicy) -> None:
        """Take over the weights of another network."""

    def learn(self, segment: int) -> bool:
        """Learn for one segment."""

    def save(self, path: Path) -> None:
        """Write all that the next segment depends on."""

    def restore(self, path: Path) -> None:
        """Go on from what `save` wrote."""

    def log(self, scores: dict[str, float]) -> None:
        """Write scores to TensorBoard."""

    def close(self) -> None:
        """Close everything."""


@dataclass(frozen=True)
class Plan:
    """All that decides the result of a training."""

    task: Task
    settings: PPOSettings
    seed: int
    engine: EngineName = "sb3"
    teacher: str = ""
    """Spec of a policy to imitate before; empty for none."""
    imitation: ImitationSettings = field(default_factory=ImitationSettings)
    validation_episodes: int = 40
    """Validation worlds after each segment: with 40 in the plane the area under the coverage curve
    is known to 3 % of itself."""

    def __post_init__(self) -> None:
        if self.engine not in get_args(EngineName):
            raise ValueError(
                f"engine must be {' or '.join(get_args(EngineName))}, got {self.engine!r}"
            )
        if self.validation_episodes < 1:
            raise ValueError(
                f"validation_episodes must be at least 1, got {self.validation_episodes}"
            )


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
    record = _read_record(out / RECORD) or _new_record(plan, command)
    _check_same(record, plan, out)
    if record["rows"] and record["rows"][-1]["steps"] >= plan.settings.total_steps:
        return record
    record["plan"] = _as_json(plan)  # total_steps may have grown
    engine = _engine(plan, workers, out / "tensorboard")
    validation = plan.task.on("validation")
    try:
        if record["rows"]:
            engine.restore(out / record["checkpoint"])
        elif plan.teacher:
            record["imitation"] = _imitate(plan, engine)
        while engine.steps < plan.settings.total_steps:
            segment = len(record["rows"])
            engine.learn(segment)
            scores = _validate(validation, engine.network, plan.validation_episodes)
            _note(record, engine, scores)
            engine.log({f"validation/{name}": value for name, value in scores.items()})
            _write(record, engine, plan, out)
            say(_line(record, plan))
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
    network = engine.network
    teacher = make_policy(plan.teacher)
    report = clone(network, plan.task, teacher, plan.imitation, plan.seed)
    engine.begin_with(network)
    return {**asdict(report), "seconds": time.perf_counter() - began}


def _validate(env: Any, network: ActorCriticPolicy, episodes: int) -> dict[str, float]:
    table = evaluate(env, LearnedPolicy(network), range(episodes)).table
    return {name: float(table[name].mean()) for name in SCORES}


def _note(record: dict[str, Any], engine: Engine, scores: Mapping[str, float]) -> None:
    """Add the row of a segment."""
    report = engine.report
    record["rows"].append(
        {
            "steps": engine.steps,
            "return": float(np.mean(report.returns)) if report.returns else None,
            "validation": dict(scores),
            "seconds": report.seconds,
            "environment_seconds": report.environment_seconds,
            "collecting_seconds": report.collecting_seconds,
        }
    )


def _write(record: dict[str, Any], engine: Engine, plan: Plan, out: Path) -> None:
    """Write the checkpoint, the policy if it is the best one so far, and then the record."""
    out.mkdir(parents=True, exist_ok=True)
    rows, before = record["rows"], record["checkpoint"]
    record["checkpoint"] = f"checkpoint-{len(rows)}.pt"
    engine.save(out / record["checkpoint"])
    rewards = [row["validation"]["reward"] for row in rows]
    if rewards[-1] == max(rewards):
        record["best"] = len(rows) - 1
        said = {"plan": record["plan"], "steps": engine.steps, "validation": rows[-1]["validation"]}
        save_policy(engine.network, plan.settings, out / POLICY, said)
    write_atomically(out / RECORD, json.dumps(record, indent=1) + "\n")
    if before and before != record["checkpoint"]:
        (out / before).unlink(missing_ok=True)


def _line(record: Mapping[str, Any], plan: Plan) -> str:
    row, best = record["rows"][-1], record["rows"][record["best"]]
    left = (plan.settings.total_steps - row["steps"]) / (row["steps"] / _total(record, "seconds"))
    return (
        f"{row['steps']:>9,} of {plan.settings.total_steps:,} steps   "
        f"validation: reward {row['validation']['reward']:.4f} "
        f"(best {best['validation']['reward']:.4f}), area under the coverage curve "
        f"{100 * row['validation']['coverage_auc']:.2f} %   about {left / 60:.0f} min left"
    )


def _total(record: Mapping[str, Any], name: str) -> float:
    return float(sum(row[name] for row in record["rows"]))


def _new_record(plan: Plan, command: str) -> dict[str, Any]:
    return {
        "version": coopmap_env.__version__,
        "command": command,
        "machine": f"{platform.system()} {platform.machine()}, Python {platform.python_version()}",
        "plan": _as_json(plan),
        "imitation": None,
        "rows": [],
        "best": None,
        "checkpoint": "",
    }


def _read_record(path: Path) -> dict[str, Any] | None:
    if not path.exists():
        return None
    try:
        record: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        if record["rows"] is None or record["plan"] is None:
            raise KeyError("rows")
    except (json.JSONDecodeError, KeyError, TypeError) as error:
        raise ValueError(
            f"{path} is broken ({error!r}): remove its folder to begin anew"
        ) from error
    return record


def _check_same(record: Mapping[str, Any], plan: Plan, out: Path) -> None:
    """Refuse to go on with another training; only its length may differ."""
    was, now = _flat(record["plan"]), _flat(_as_json(plan))
    was["version"], now["version"] = record["version"], coopmap_env.__version__
    for key in sorted(set(was) | set(now)):
        if key != "settings.total_steps" and was.get(key) != now.get(key):
            raise ValueError(
                f"{out} holds another training, with {key} = {was.get(key)!r}, not "
                f"{now.get(key)!r}: use another folder"
            )


def _as_json(plan: Plan) -> dict[str, Any]:
    values: dict[str, Any] = json.loads(json.dumps(asdict(plan)))
    return values


def _flat(values: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in values.items():
        name = f"{before}{key}"
        flat.update(_flat(value, f"{name}.") if isinstance(value, dict) else {name: value})
    return flat
