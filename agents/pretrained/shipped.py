"""The policies that ship with coopmap: which there are, and where their files lie.

Each is a folder of `policies/`: one file for every training seed, and ``training.json`` with the
command, the hardware, the time and the learning curves.
"""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

from coopmap_agents.record import RECORD_FILE


def pretrained_names() -> list[str]:
    """Names of all policies that ship."""
    return sorted(path.parent.name for path in _folder().glob(f"*/{RECORD_FILE}"))


def pretrained_record(name: str) -> dict[str, Any]:
    """How a policy was made, and its learning curves.

    Raises
    ------
    ValueError
        With the choices, if there is none of that name.
    """
    if name not in pretrained_names():
        raise ValueError(
            f"no policy {name!r} ships; there are {', '.join(pretrained_names()) or 'none'}"
        )
    record: dict[str, Any] = json.loads(
        (_folder() / name / RECORD_FILE).read_text(encoding="utf-8")
    )
    return record


def pretrained_path(name: str, seed: int | None = None) -> Path:
    """File of a policy that ships.

    Parameters
    ----------
    name : str
        One of `pretrained_names`.
    seed : int, optional
        Of the training; by default the one that did best on validation worlds.

    Raises
    ------
    ValueError
        With the choices, if there is no such policy or seed.
    """
    record = pretrained_record(name)
    if seed is None:
        seed = int(record["best_seed"])
    if seed not in record["seeds"]:
        raise ValueError(f"{name} was trained with the seeds {record['seeds']}, got {seed}")
    return _folder() / name / f"seed_{seed}.safetensors"


def _folder() -> Path:
    return Path(str(files(__package__ or "coopmap_agents") / "policies"))
