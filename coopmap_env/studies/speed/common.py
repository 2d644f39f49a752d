"""Measurements that the planar and the field benchmark share."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Mapping
from typing import Any

from coopmap_env.core.extras import import_optional
from coopmap_env.studies.common.records import significant
from coopmap_env.studies.speed.measure import Ratio


def figures_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """JSON values with five significant digits; quartiles of ratios under a key of their own."""
    quartiles = {name: value for name, value in values.items() if isinstance(value, Ratio)}
    figures = {
        name: value.estimate if isinstance(value, Ratio) else value
        for name, value in values.items()
    }
    return {
        **{
            name: significant(value) if isinstance(value, float) else value
            for name, value in figures.items()
        },
        "quartiles_over_rounds": {
            name: [significant(bound) for bound in value.quartiles]
            for name, value in quartiles.items()
        },
    }


def resident_memory_mb(env_name: str, episodes: int) -> float:
    """Resident memory of a fresh process after some random episodes, in MiB.

    Parameters
    ----------
    env_name : {"planar", "field"}
    episodes : int

    Raises
    ------
    ImportError
        With the pip command, if psutil is not installed.
    """
    import_optional("psutil", "bench")
    code = (
        f"import psutil; from coopmap_env import {env_name}_v1\n"
        f"env = {env_name}_v1.parallel_env()\n"
        f"for seed in range({episodes}):\n"
        "    env.reset(seed=seed)\n"
        "    while env.agents: env.step({a: env.action_space(a).sample() for a in env.agents})\n"
        "print(psutil.Process().memory_info().rss / 2**20)"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", code], capture_output=True, text=True, check=True
    )
    return float(done.stdout.split()[-1])
