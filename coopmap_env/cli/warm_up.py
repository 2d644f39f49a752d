"""The command `coopmap warm-up`."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import ClassVar, Literal

from coopmap_env.cli.results import duration
from coopmap_env.core.extras import missing_extras, pip_command
from coopmap_env.core.progress import log

EnvName = Literal["planar", "field"]
N_SCANS = 2
"""Of the episodes that are played: the second one plans on a map."""


@dataclass(frozen=True, kw_only=True)
class WarmUp:
    """Compile the kernels, for which a first episode would wait.

    Numba compiles for the processor of this machine, and keeps the result beside the installed
    files, or in the folder that NUMBA_CACHE_DIR names. Short episodes are played for it; those
    that find all kernels compiled take seconds.

    Such as:
      coopmap warm-up
      coopmap warm-up --env planar --policies rating_function,frontier
    """

    PURPOSE: ClassVar[str] = "this machine"

    env: Literal["planar", "field", "all"] = "all"
    """Environments. Without the extra field, "all" is the planar one."""
    policies: str = "rating_function:search=10"
    """Policies whose kernels are compiled too, separated by commas."""

    def extras(self) -> list[str]:
        """Extras of the environment that is asked for by its name."""
        return ["field"] if self.env == "field" else []

    def run(self) -> None:
        """Play a short episode in each environment and action mode."""
        from coopmap_env.evaluation import check_policy

        policies = [name.strip() for name in self.policies.split(",") if name.strip()]
        if not policies:
            raise ValueError("--policies names no policy")
        for policy in policies:
            check_policy(policy)
        for env_name in self._env_names():
            for mode in ("pose", "candidates"):
                for policy in policies:
                    warm_up(env_name, mode, policy)

    def _env_names(self) -> Iterator[EnvName]:
        if self.env != "field":
            yield "planar"
        if self.env != "planar":
            if missing := missing_extras(["field"]):
                log(f"without the field, which needs: {pip_command(missing)}")
            else:
                yield "field"


def warm_up(env_name: EnvName, mode: str, policy: str) -> None:
    """Play one short episode, and say what was compiled for it."""
    from coopmap_env.core.kernel_cache import compiled_kernels
    from coopmap_env.evaluation import get_env_spec, make_policy, run_episode

    start, n_before = time.monotonic(), len(compiled_kernels)
    log(f"{env_name}, {mode} mode, {policy} ...")
    arguments = {"action_mode": mode, "max_scans": N_SCANS, "report_shown": True}
    with closing(get_env_spec(env_name).make(**arguments)) as env:
        run_episode(env, make_policy(policy), 0)
    n = len(compiled_kernels) - n_before
    log(f"  {n} kernels compiled in {duration(time.monotonic() - start)}")
