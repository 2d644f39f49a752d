"""Our PPO loop beside Stable-Baselines3: speed, and scores after equally long trainings.

::

    python -m coopmap_env.studies.engine_comparison OUT --seeds 0 1 2

trains planar candidates by coverage with each engine (about 5 minutes a seed on an idle core) and
measures agent-steps per second of CPU time, in turns in one process. OUT/summary.json
has the scores on validation worlds, of the best and of the last network, and the speeds. A training
that was interrupted goes on.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import replace
from pathlib import Path
from typing import Any

from coopmap_agents.config import EngineName, EnvConfig, PPOSettings, TrainingConfig
from coopmap_agents.ppo import PPOTrainer
from coopmap_agents.sb3 import SB3Trainer
from coopmap_agents.trainer import Trainer
from coopmap_agents.training import run_training
from coopmap_env.cli.errors import errors_as_lines
from coopmap_env.core.files import write_atomically
from coopmap_env.core.progress import log
from coopmap_env.studies.common.records import significant

ENV = EnvConfig("planar", {"action_mode": "candidates", "reward": "coverage"})
SETTINGS: dict[EngineName, PPOSettings] = {
    "sb3": PPOSettings(),
    "ppo": PPOSettings(n_envs=32, rollout_steps=32, n_epochs=1, learning_rate=1e-3),
}
"""The defaults, and those that are fastest for candidates: many worlds, one pass, a higher rate."""
VALIDATION_EPISODES = 100
SCORES = ("coverage_auc", "coverage", "reward")


def measure_speed(repetitions: int = 3, rollouts: int = 2) -> dict[str, float]:
    """Agent-steps per second of this process's CPU time, the most of some segments of each.

    Each engine has its own settings, and Stable-Baselines3 those of the other one too. All take
    turns, so that a busy machine slows all.
    """
    cases: dict[str, tuple[Callable[..., Trainer], PPOSettings]] = {
        "sb3": (SB3Trainer, SETTINGS["sb3"]),
        "ppo": (PPOTrainer, SETTINGS["ppo"]),
        "sb3 with the settings of ppo": (SB3Trainer, SETTINGS["ppo"]),
    }
    steps = {
        name: rollouts * 2 * own.n_envs * own.rollout_steps for name, (_, own) in cases.items()
    }
    seconds: dict[str, list[float]] = {name: [] for name in cases}
    with ExitStack() as stack:
        trainers: dict[str, Trainer] = {}
        for name, (trainer, settings) in cases.items():
            sized = replace(settings, segment_steps=steps[name], total_steps=1 << 40)
            trainers[name] = stack.enter_context(closing(trainer(ENV, sized, seed=0)))
        for segment in range(repetitions + 1):
            for name, running in trainers.items():
                start = time.process_time()
                running.learn(segment)
                seconds[name].append(time.process_time() - start)
    # the first segment loads kernels
    return {name: steps[name] / min(seconds[name][1:]) for name in cases}


def train_engine(engine: EngineName, seed: int, out: Path, total_steps: int) -> dict[str, Any]:
    """Scores of one training on validation worlds, of its best and of its last network."""
    config = TrainingConfig(
        env=ENV,
        engine=engine,
        seed=seed,
        ppo=replace(SETTINGS[engine], total_steps=total_steps),
        validation_episodes=VALIDATION_EPISODES,
    )
    rows = run_training(config, out / engine / str(seed), log=log)["rows"]
    best = max(rows, key=lambda row: row["validation"]["reward"])
    return {
        name: {score: significant(row["validation"][score]) for score in SCORES}
        for name, row in (("best", best), ("last", rows[-1]))
    }


def main(arguments: list[str] | None = None) -> None:
    """Train with both engines, measure them, and write the summary."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n", 1)[0])
    parser.add_argument("out", type=Path, help="folder of the trainings and of summary.json")
    parser.add_argument("--seeds", type=int, nargs="+", default=[0, 1, 2])
    parser.add_argument("--total-steps", type=int, default=PPOSettings().total_steps)
    parser.add_argument("--only-speed", action="store_true", help="train nothing")
    options = parser.parse_args(arguments)
    summary: dict[str, Any] = {
        "agent_steps_per_cpu_second": {
            name: significant(speed) for name, speed in measure_speed().items()
        }
    }
    for engine in () if options.only_speed else SETTINGS:
        summary[engine] = {
            str(seed): train_engine(engine, seed, options.out, options.total_steps)
            for seed in options.seeds
        }
    write_atomically(options.out / "summary.json", json.dumps(summary, indent=1) + "\n")
    log(json.dumps(summary, indent=1))


if __name__ == "__main__":
    with errors_as_lines("engine_comparison"):
        main()
