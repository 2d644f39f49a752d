"""The pretrained policies, which ship with coopmap: their names, files and records.

Each is a folder of ``policies/``: two files for each training seed, with the same weights as
safetensors and as ONNX, and ``training.json`` with the commands, the hardware, the time and the
learning curves.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from importlib.resources import files
from numbers import Integral
from pathlib import Path
from typing import Any, Literal

from coopmap_agents._record_form import check_pretrained_record
from coopmap_agents.record import POLICY_FILE, RECORD_FILE
from coopmap_env.core.files import FileError, brief, read_json

FileFormat = Literal["safetensors", "onnx"]


def pretrained_names() -> list[str]:
    """Names of all pretrained policies."""
    return sorted(path.parent.name for path in _folder().glob(f"*/{RECORD_FILE}"))


def pretrained_record(name: str) -> dict[str, Any]:
    """Record of the trainings of a pretrained policy, with their learning curves.

    Raises
    ------
    ValueError
        With the choices, if the name is unknown.
    FileError
        If its file is broken.
    """
    if name not in pretrained_names():
        raise ValueError(
            f"no pretrained policy {name!r}; there are {', '.join(pretrained_names()) or 'none'}"
        )
    path = _folder() / name / RECORD_FILE
    record: dict[str, Any] = read_json(path)
    try:
        check_pretrained_record(record)
    except (ValueError, LookupError, TypeError) as error:
        raise FileError(f"{path} is broken ({error}): install coopmap again") from error
    return record


def pretrained_path(
    name: str, seed: int | None = None, file_format: FileFormat = "safetensors"
) -> Path:
    """File of a pretrained policy.

    Parameters
    ----------
    name : str
        One of `pretrained_names`.
    seed : int, optional
        Seed of the training; by default the one with the largest reward on validation worlds.
    file_format : {"safetensors", "onnx"}
        Both files have the same weights and metadata.

    Raises
    ------
    ValueError
        With the choices, if there is no such policy or seed.
    """
    record = pretrained_record(name)
    if seed is None:
        seed = record["best_seed"]
    seed = training_seed(f"{name} was", seed, record["seeds"])
    return _folder() / name / f"seed_{seed}.{file_format}"


def training_seed(what: str, seed: Any, seeds: Sequence[int]) -> int:
    """A seed of trainings, as an integer.

    Parameters
    ----------
    what : str
        What was trained, with its verb, for the message.
    seed
    seeds : sequence of int
        Of all trainings.

    Raises
    ------
    ValueError
        With the seeds, if it is none of them.
    """
    is_integer = isinstance(seed, Integral) and not isinstance(seed, bool)  # True and 1.0 equal 1
    if not is_integer or seed not in seeds:
        raise ValueError(f"{what} trained with the seeds {seeds}, got {seed!r:.80}")
    return int(seed)


def find_policy(model: Any, seed: int | None, file_format: FileFormat = "safetensors") -> Path:
    """File of a policy: of a pretrained one, if `model` is its name, else of this path.

    Raises
    ------
    ValueError
        If there is neither, or a seed is given for a file.
    """
    if isinstance(model, str) and model in pretrained_names():
        return pretrained_path(model, seed, file_format)
    _check_is_file(model)
    if seed is not None:
        raise ValueError(
            f"seed={seed} selects a training of a pretrained policy; {model} is a file"
        )
    return Path(model)


def _check_is_file(model: Any) -> None:
    is_path = isinstance(model, str | os.PathLike)
    if is_path and os.path.isfile(model):
        return
    if is_path and os.path.isdir(model):
        raise ValueError(
            f"model {str(model)!r} is a folder: name a file in it, such as {POLICY_FILE}"
        )
    raise ValueError(
        f"model {brief(model)} is neither a file nor one of the pretrained policies: "
        f"{', '.join(pretrained_names()) or 'none'}"
    )


def _folder() -> Path:
    return Path(str(files("coopmap_agents.pretrained") / "policies"))
