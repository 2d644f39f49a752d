"""What a submission says of itself and nobody can verify: machine, versions, size of the model."""

from __future__ import annotations

import os
import platform
from pathlib import Path
from typing import Any

from coopmap_env.core.versions import versions

LIBRARIES = (
    "numpy", "scipy", "numba", "gymnasium", "pettingzoo", "torch", "pybullet", "embreex",
)  # fmt: skip
"""On which results may depend; those that are installed are named."""
CPU_INFO = Path("/proc/cpuinfo")


def own_versions() -> dict[str, str]:
    """Versions of coopmap, Python and `LIBRARIES`."""
    return versions(LIBRARIES)


def other_versions(stated: dict[str, str]) -> list[str]:
    """What differs from the versions that run here, such as "numpy 2.0.0 (here 2.4.1)"."""
    own = own_versions()
    return [
        f"{name} {text} (here {own.get(name, 'none')})"
        for name, text in stated.items()
        if own.get(name) != text
    ]


def machine() -> dict[str, str | int]:
    """Processor, cores and system; nothing that names the machine."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count() or 1,
        "system": f"{platform.system()} {platform.machine()}",
    }


def _processor() -> str:
    """Name of the processor, as far as the system says it."""
    try:
        lines = CPU_INFO.read_text(errors="replace").splitlines()
    except OSError:  # not on Linux
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or "unknown"


def model_size(policy: Any) -> dict[str, int | None]:
    """``model_bytes`` and ``n_parameters``, if the policy has attributes of these names."""
    sizes = {name: getattr(policy, name, None) for name in ("model_bytes", "n_parameters")}
    return {name: None if size is None else int(size) for name, size in sizes.items()}
