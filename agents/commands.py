"""The commands `coopmap train` and `coopmap train-map`; torch is imported only when they run."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field, fields
from functools import partial
from pathlib import Path
from typing import ClassVar

from coopmap_agents.config import EnvConfig, TrainingConfig, TrainingOptions
from coopmap_agents.map_config import MapTrainingConfig, MapTrainingOptions
from coopmap_env.cli.environment import EnvironmentOptions
from coopmap_env.cli.results import new_results_path
from coopmap_env.core.progress import log
from coopmap_env.envs import RewardName
from coopmap_env.envs.arguments import ActionModeName


@dataclass(frozen=True, kw_only=True)
class Train(EnvironmentOptions, TrainingOptions):
    """Train a policy that all robots of a team share.

    Writes policy.safetensors (the best one on validation worlds, for `coopmap evaluate --policies
    learned:model=...`), policy.onnx (the same, for acting without torch), training.json
    (configuration and learning curve), a checkpoint and logs for TensorBoard. The same command with
    --out resumes an interrupted training, with the same result as without the interruption. Needs
    the extra rl, and ray for --engine rllib.

    Such as:
      coopmap train --out results/train --ppo.total-steps 100000
      coopmap train --env field --imitate rating_function --workers 2 --out results/train-field
      coopmap train --engine rllib --workers 2 --out results/train-ray
    """

    PURPOSE: ClassVar[str] = "train policies"

    out: Path = field(default_factory=partial(new_results_path, "train"))
    """Folder of the training. With that of an interrupted one, it goes on."""
    workers: int = 0
    """Processes for the environments. 0 steps them in this one."""
    action_mode: ActionModeName = "candidates"
    """Any pose (field: joints of the mount), or a choice among random candidates."""
    reward: RewardName = "coverage"
    """The reward that is learned from."""

    def extras(self) -> list[str]:
        """Extras of the environment and the training."""
        return [*super().extras(), "rl", *(["ray"] if self.engine == "rllib" else [])]

    def run(self) -> None:
        """Train, and say where the policy is."""
        from coopmap_agents.record import POLICY_FILE, throughput_line
        from coopmap_agents.training import run_training
        from coopmap_env.core.settings import settings_to_dict

        settings = self.settings()
        values = None if settings is None else settings_to_dict(settings)
        env = EnvConfig(self.env_name, self.env_kwargs(), values)
        options = {option.name: getattr(self, option.name) for option in fields(TrainingOptions)}
        record = run_training(
            TrainingConfig(env=env, **options),
            self.out,
            self.workers,
            log,
            shlex.join(["coopmap", *sys.argv[1:]]),
        )
        log(throughput_line(record))
        best = record["rows"][record["best"]]
        log(
            f"policy: {self.out / POLICY_FILE}, after {best['steps']:,} steps; validation reward "
            f"{best['validation']['reward']:.4f}"
        )


@dataclass(frozen=True, kw_only=True)
class TrainMap(MapTrainingOptions):
    """Train a network that predicts the unknown part of maps.

    Writes map.safetensors (the best one on validation worlds, for `coopmap evaluate --policies
    predictive:model=...`, in the field predictive_surface:model=...), map.onnx (the same, for
    predicting without torch), training.json (configuration and learning curve), a checkpoint, and
    the maps that it learns from. The same command with --out resumes an interrupted training, with
    the same result as without the interruption. Needs the extra rl.

    Options that are left out are those of the network that ships with coopmap for the environment.

    Such as:
      coopmap train-map --out results/map
      coopmap train-map --families crowded --scenes --episodes 100 --out results/map-crowded
      coopmap train-map --env-name field --out results/map-field
    """

    PURPOSE: ClassVar[str] = "train policies"

    out: Path = field(default_factory=partial(new_results_path, "train-map"))
    """Folder of the training. With that of an interrupted one, it goes on."""

    def extras(self) -> list[str]:
        """Extras of the training."""
        return ["rl"]

    def run(self) -> None:
        """Train, and say where the network is."""
        from coopmap_agents.map_prediction import run_map_training
        from coopmap_agents.map_prediction.record import progress_line
        from coopmap_agents.map_prediction.training import MODEL_FILE

        values = {option.name: getattr(self, option.name) for option in fields(MapTrainingOptions)}
        command = shlex.join(["coopmap", *sys.argv[1:]])
        record = run_map_training(MapTrainingConfig(**values), self.out, log, command)
        log(f"network: {self.out / MODEL_FILE}; {progress_line(record).strip()}")
