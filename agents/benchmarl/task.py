"""The environments as tasks of BenchMARL, on TorchRL's wrapper of PettingZoo."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any, cast

from benchmarl.environments import Task, TaskClass
from tensordict import TensorDictBase
from torchrl.data import Composite
from torchrl.envs import EnvBase
from torchrl.envs.libs.pettingzoo import PettingZooWrapper

from coopmap_env import families, field_v1, planar_v1
from coopmap_env.envs import MappingEnv

MODES = {True: "pose", False: "candidates"}
"""Action modes: of continuous and of discrete actions."""
INFO_KEYS = ("observed_fraction", "rejected_reason")
"""What BenchMARL keeps of the infos."""


class CoopmapTaskClass(TaskClass):
    """A task: a world with settings, or a benchmark family.

    Parameters
    ----------
    name : str
        Of the member of `CoopmapTask`.
    config : dict or None
        Keyword arguments of ``planar_v1.parallel_env`` or ``field_v1.parallel_env``; of a family:
        ``split`` (default "train") and what `coopmap_env.families.Family.make` takes. Without
        ``action_mode``, robots act by poses where BenchMARL prefers continuous actions, and
        otherwise choose among candidates.
    """

    def get_env_fun(
        self, num_envs: int, continuous_actions: bool, seed: int | None, device: Any
    ) -> Callable[[], EnvBase]:
        """A function that makes one environment; BenchMARL makes `num_envs` of them."""
        mode = self.config.get("action_mode", MODES[continuous_actions])
        return lambda: _wrapped(self._make({**self.config, "action_mode": mode}), seed, device)

    def _make(self, options: dict[str, Any]) -> MappingEnv[Any]:
        if self.name == "PLANAR":
            return planar_v1.parallel_env(**options)
        if self.name == "FIELD":
            return field_v1.parallel_env(**options)
        return families.make(self.name.lower().replace("_", "-"), **options)

    def supports_continuous_actions(self) -> bool:
        """Whether robots may act by poses."""
        return self.config.get("action_mode", MODES[True]) == MODES[True]

    def supports_discrete_actions(self) -> bool:
        """Whether robots may choose among candidates."""
        return self.config.get("action_mode", MODES[False]) == MODES[False]

    def max_steps(self, env: EnvBase) -> int:
        """Scans in an episode at most."""
        return _coopmap(env).max_scans

    def has_render(self, env: EnvBase) -> bool:
        """Whether evaluations can be filmed: where ``render_mode`` is "rgb_array"."""
        return _coopmap(env).render_mode == "rgb_array"

    def group_map(self, env: EnvBase) -> dict[str, list[str]]:
        """One group with all robots, which have the same spaces."""
        return cast("dict[str, list[str]]", env.group_map)

    def observation_spec(self, env: EnvBase) -> Composite:
        """All entries of observations; with the mask, which models need as well."""
        return _only(env, "observation", "action_mask")

    def action_mask_spec(self, env: EnvBase) -> Composite | None:
        """Masks of candidates; none of poses."""
        spec = _only(env, "action_mask")
        return None if spec.is_empty() else spec

    def info_spec(self, env: EnvBase) -> Composite:
        """The entries of infos that `log_info` reads."""
        spec = _only(env, "info")
        for group in env.group_map:
            for key in set(spec[group, "info"].keys()) - set(INFO_KEYS):
                del spec[group, "info"][key]
        return spec

    def state_spec(self, env: EnvBase) -> None:
        """None: central critics pool over the observations of all robots."""

    def action_spec(self, env: EnvBase) -> Composite:
        """Actions of the group."""
        return env.full_action_spec

    @staticmethod
    def log_info(batch: TensorDictBase) -> dict[str, float]:
        """What was observed of the world when episodes ended, and the share of rejected actions."""
        (infos,) = (
            played["info"]
            for played in batch["next"].values()
            if isinstance(played, TensorDictBase) and "info" in played.keys()  # noqa: SIM118
        )
        ended = batch["next", "done"].squeeze(-1)
        logged = {"coopmap/rejected_fraction": _mean(infos["rejected_reason"] != 0)}
        if ended.any():
            logged["coopmap/observed_fraction"] = _mean(infos["observed_fraction"][ended])
        return logged

    @staticmethod
    def env_name() -> str:
        """Name of the environment in BenchMARL's records."""
        return "coopmap"


class CoopmapTask(Task):
    """Tasks of BenchMARL: the two worlds with any settings, and the benchmark families."""

    PLANAR = None
    FIELD = None
    CROWDED = None
    LONG = None
    MOTION_BUDGET = None
    NARROW = None
    OCCLUDED = None
    TIME = None

    @staticmethod
    def associated_class() -> type[TaskClass]:
        """The class of all members."""
        return CoopmapTaskClass

    def get_from_yaml(self, path: str | None = None) -> TaskClass:
        """The task with the settings of a file; without one, with the defaults."""
        return self.get_task({}) if path is None else super().get_from_yaml(path)


def _wrapped(env: MappingEnv[Any], seed: int | None, device: Any) -> EnvBase:
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="PettingZoo in TorchRL is tested using")
        return PettingZooWrapper(env, categorical_actions=True, seed=seed, device=device)


def _coopmap(env: EnvBase) -> MappingEnv[Any]:
    while not isinstance(env, PettingZooWrapper):
        env = env.base_env
    return cast("MappingEnv[Any]", env._env)


def _only(env: EnvBase, *kept: str) -> Composite:
    """The observations of the groups without other entries."""
    groups = {
        group: Composite(
            {key: spec.clone() for key, spec in env.observation_spec[group].items() if key in kept},
            shape=env.observation_spec[group].shape,
        )
        for group in env.group_map
    }
    return Composite({group: spec for group, spec in groups.items() if not spec.is_empty()})


def _mean(values: Any) -> float:
    return float(values.float().mean())
