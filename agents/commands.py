"""The command `coopmap train`; torch is imported only when it runs."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from coopmap_agents.plan import EngineName, EnvConfig, TrainingConfig
from coopmap_agents.settings import ImitationSettings, PPOSettings

from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.core.progress import log


@dataclass(frozen=True, kw_only=True)
class Train(EnvironmentOptions):
    """Train a policy that all robots of a team share.

    Writes policy.safetensors (the best one on validation worlds, for `coopmap evaluate --policies
    learned:model=...`), training.json (all about it, and the learning curve), a checkpoint and logs
    for TensorBoard. The same command goes on after an interruption, and ends as if there had been
    none. Needs the extra rl, and ray for --engine rllib.

    Such as:
      coopmap train --out results/train --ppo.total-steps 100000
      coopmap train --env field --imitate rating_function --workers 2 --out results/train-field
      coopmap train --engine rllib --workers 2 --out results/train-ray
    """

    out: Path
    """Folder of the training."""
    seed: int = 0
    """Decides everything."""
    engine: EngineName = "sb3"
    """Who learns: Stable-Baselines3, or RLlib on Ray (on the cluster that RAY_ADDRESS names)."""
    workers: int = 0
    """Processes for the environments; 0 steps them in this one."""
    init_from: str = ""
    """Policy whose weights to begin with: a file, or the name of one that ships."""
    imitate: str = ""
    """Policy to imitate first, such as rating_function, with options as in `coopmap evaluate`. Let
    the critic learn for a while then (--ppo.critic-warmup-steps), before it moves the policy."""
    validation_episodes: int = 40
    """Validation worlds that the policy plays after each segment."""
    action_mode: Literal["pose", "candidates"] = "candidates"
    """Any pose (in the field: joints of the mount), or a choice among random candidates."""
    reward: Literal["rating", "information", "coverage"] = "coverage"
    """The reward that is learned from."""
    ppo: PPOSettings = field(default_factory=PPOSettings)
    """Of proximal policy optimisation."""
    imitation: ImitationSettings = field(default_factory=ImitationSettings)
    """Of the imitation."""

    def run(self) -> None:
        """Train, and say where the policy is."""
        from coopmap_agents.record import POLICY_FILE, throughput_line
        from coopmap_agents.training.loop import run_training

        from coopmap_env.core.serial import settings_to_dict

        settings = self.settings()
        made = None if settings is None else settings_to_dict(settings)
        config = TrainingConfig(
            EnvConfig(self.env, self.env_kwargs(), made),
            self.ppo,
            self.seed,
            self.engine,
            self.init_from,
            self.imitate,
            self.imitation,
            self.validation_episodes,
        )
        record = run_training(
            config, self.out, self.workers, log, shlex.join(["coopmap", *sys.argv[1:]])
        )
        log(throughput_line(record))
        best = record["rows"][record["best"]]
        log(
            f"policy: {self.out / POLICY_FILE}, after {best['steps']:,} steps; validation reward "
            f"{best['validation']['reward']:.4f}"
        )
