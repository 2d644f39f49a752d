"""Checkpoints: everything that the next segment of a training depends on.

A checkpoint is read by `torch.load` with ``weights_only``, which makes tensors and plain values and
runs no code. What else it could do is excluded before: the file is a regular one and no link, its
records are together no larger than the file, and all that it holds must be of the network and of
the record that it belongs to.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import torch
from torch import nn
from torch.optim import Optimizer

from coopmap_agents._record_form import checkpoint_name
from coopmap_env.core.files import FileError, brief, read_bytes, write_atomically


def save_checkpoint(path: Path, network: nn.Module, optimizer: Optimizer, steps: int) -> None:
    """Write a checkpoint, atomically; it holds no code.

    Parameters
    ----------
    path : Path
    network : torch.nn.Module
    optimizer : torch.optim.Optimizer
        Of its weights; Adam or AdamW.
    steps : int
        Number of steps learned from.
    """
    states = {"network": network.state_dict(), "optimizer": optimizer.state_dict()}
    content = io.BytesIO()
    torch.save({"steps": steps, **states}, content)
    write_atomically(path, content.getvalue())


def load_checkpoint(
    path: Path, network: nn.Module, optimizer: Optimizer, steps: int | None = None
) -> int:
    """Load a checkpoint into a network and its optimizer; gives the number of steps.

    Parameters
    ----------
    path : Path
    network : torch.nn.Module
        Made with the settings of the checkpoint.
    optimizer : torch.optim.Optimizer
        Likewise.
    steps : int, optional
        Number of steps that the checkpoint has to be of.

    Raises
    ------
    FileError
        If the file cannot be read, or is of another network or number of steps.
    """
    values = _read(path)
    try:
        _check_values(values, network, optimizer, steps)
        network.load_state_dict(values["network"])
        optimizer.load_state_dict(values["optimizer"])
    except Exception as error:  # torch raises many types of exceptions for odd values
        raise FileError(
            f"the checkpoint {path} is of another network: {error!s:.500}: "
            "remove its folder to start again"
        ) from error
    return int(values["steps"])


def remove_other_checkpoints(folder: Path, n_rows: int) -> None:
    """Remove the checkpoint before that of so many rows, and one that a killed training left."""
    for other in (n_rows - 1, n_rows + 1):
        (folder / checkpoint_name(other)).unlink(missing_ok=True)


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.is_symlink():
            raise FileError("it is a link")
        content = read_bytes(path)
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            if sum(entry.file_size for entry in archive.infolist()) > len(content):
                raise FileError("its records are larger than the file")
        values = torch.load(io.BytesIO(content), map_location="cpu", weights_only=True)
        if not isinstance(values, dict) or set(values) != {"steps", "network", "optimizer"}:
            raise FileError(f"it holds {brief(values)}")
    except Exception as error:  # torch raises many types of exceptions for a broken file
        raise FileError(
            f"the checkpoint {path} cannot be read ({error!s:.500}): "
            "remove its folder to start again"
        ) from error
    return values


def _check_values(
    values: dict[str, Any], network: nn.Module, optimizer: Optimizer, steps: int | None
) -> None:
    """ValueError if a value is not of a checkpoint of this network."""
    if type(values["steps"]) is not int or steps not in (None, values["steps"]):
        raise ValueError(f"it is after {brief(values['steps'])} steps, not {steps}")
    _check_tensors(values["network"], network.state_dict(), "the weights")
    found = values["optimizer"]
    if found["param_groups"] != optimizer.state_dict()["param_groups"]:
        raise ValueError("its optimizer has other settings")
    parameters = [one for group in optimizer.param_groups for one in group["params"]]
    for index, state in found["state"].items():
        needed = dict.fromkeys(("exp_avg", "exp_avg_sq"), parameters[index])
        _check_tensors(state, {"step": torch.zeros(()), **needed}, f"optimizer.state[{index}]")


def _check_tensors(found: dict[str, Any], needed: dict[str, torch.Tensor], what: str) -> None:
    if set(found) != set(needed):
        raise ValueError(f"{what} are {brief(sorted(found))}, not {brief(sorted(needed))}")
    for name, tensor in needed.items():
        values = found[name]
        if not isinstance(values, torch.Tensor) or values.shape != tensor.shape:
            shape = tuple(getattr(values, "shape", ()))
            raise ValueError(f"{what}: {name} has the shape {shape}, not {tuple(tensor.shape)}")
        if values.layout != torch.strided or values.dtype != tensor.dtype:
            raise ValueError(f"{what}: {name} is of type {values.dtype}, not {tensor.dtype}")
        if not values.isfinite().all():
            raise ValueError(f"{what}: {name} must be finite numbers")
