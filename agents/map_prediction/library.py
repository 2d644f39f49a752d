"""The map networks that ship with coopmap: their files and training seeds.

Each environment has a folder in ``models/``: for each training seed two files with the same
weights, as safetensors and as ONNX, and the record of the training as JSON.
"""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Literal

from coopmap_agents.map_config import usual_environment
from coopmap_agents.pretrained.library import training_seed

DEFAULT_SEED = 0
"""Not the best one on validation worlds: these differ from seed to seed."""

FileFormat = Literal["safetensors", "onnx", "json"]


def shipped_seeds(dimension: int = 2, models: Path | None = None) -> list[int]:
    """Training seeds of the networks that ship with coopmap for maps of 2 or 3 dimensions."""
    paths = network_file(dimension, 0, models=models).parent.glob("seed_*.safetensors")
    return sorted(int(path.stem.removeprefix("seed_")) for path in paths)


def shipped_path(
    dimension: int = 2, file_format: FileFormat = "safetensors", seed: int | None = None
) -> Path:
    """File of a network that ships with coopmap for maps of 2 or 3 dimensions.

    Parameters
    ----------
    dimension : {2, 3}
    file_format : {"safetensors", "onnx", "json"}
        The first two have the same weights and metadata, the last is the record of the training.
    seed : int, optional
        Seed of the training, 0 by default.

    Raises
    ------
    ValueError
        With the choices, if there is no network of this seed.
    """
    chosen = training_seed(
        f"the networks of {usual_environment(dimension)} maps were",
        DEFAULT_SEED if seed is None else seed,
        shipped_seeds(dimension),
    )
    return network_file(dimension, chosen, file_format)


def network_file(
    dimension: int,
    seed: int,
    file_format: FileFormat = "safetensors",
    models: Path | None = None,
) -> Path:
    """Where a network that ships has its file; it may not be there.

    Parameters
    ----------
    dimension, seed, file_format
        As in `shipped_path`.
    models : Path, optional
        The folder of all networks, by default that of the installed package.
    """
    folder = models or Path(str(files("coopmap_agents.map_prediction") / "models"))
    return folder / usual_environment(dimension) / f"seed_{seed}.{file_format}"
