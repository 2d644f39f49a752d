"""Write the files of the map networks that ship with coopmap: for maintainers.

::

    python -m coopmap_agents.map_prediction.export agents/map_prediction/models results/map-planar/*

copies to the first folder the networks of these trainings, with their records, one for each seed,
and writes the ONNX files of all networks that ship. Those of other seeds stay if their settings are
the same, and are removed otherwise. See `make map-networks`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from coopmap_agents.map_config import USUAL_TRAININGS, MapTrainingConfig
from coopmap_agents.map_prediction.library import network_file, shipped_seeds
from coopmap_agents.map_prediction.model_file import convert_map_network, load_map_network
from coopmap_agents.map_prediction.record import read_record
from coopmap_agents.map_prediction.training import MODEL_FILE
from coopmap_agents.record import RECORD_FILE
from coopmap_env.core.files import FileError, read_bytes, read_json, write_atomically
from coopmap_env.core.settings import settings_from_dict, settings_to_dict


class _Training(NamedTuple):
    """What is copied of a training."""

    folder: Path
    config: MapTrainingConfig
    network: bytes
    record: bytes


def export(models: Path, folders: Sequence[Path] = ()) -> None:
    """Copy the networks of finished trainings, and write the ONNX files of all that ship.

    Parameters
    ----------
    models : Path
        Folder of the networks, in the source: the installed files may be copies.
    folders : sequence of Path
        Of `run_map_training`. Those of one environment differ in the seed only.

    Raises
    ------
    ValueError
        If trainings of an environment differ in more than their seeds, have equal seeds, or one is
        unfinished.
    FileError
        If a file of theirs is broken.
    """
    trainings = [_read(folder) for folder in folders]
    for env_name, usual in USUAL_TRAININGS.items():
        dimension = usual.network.dimension
        exported = [training for training in trainings if training.config.env_name == env_name]
        _check_same_config(exported)
        if exported:
            _remove_others(models, dimension, exported[0].config)
        for training in exported:
            seed = training.config.seed
            write_atomically(network_file(dimension, seed, models=models), training.network)
            write_atomically(network_file(dimension, seed, "json", models), training.record)
        for seed in shipped_seeds(dimension, models):
            path = network_file(dimension, seed, models=models)
            convert_map_network(path, path.with_suffix(".onnx"))


def _read(folder: Path) -> _Training:
    """A training that has reached its steps, with a network that can be loaded."""
    record = read_record(folder)
    if record is None:
        raise FileError(f"{folder / RECORD_FILE}: there is no such file")
    config = settings_from_dict(record["config"], MapTrainingConfig)
    if not record["rows"] or record["rows"][-1]["steps"] < config.total_steps:
        raise ValueError(f"{folder} is unfinished: it has not reached {config.total_steps} steps")
    load_map_network(folder / MODEL_FILE)
    return _Training(
        folder, config, read_bytes(folder / MODEL_FILE), read_bytes(folder / RECORD_FILE)
    )


def _remove_others(models: Path, dimension: int, config: MapTrainingConfig) -> None:
    """Remove the networks that ship and were trained with other settings."""
    for seed in shipped_seeds(dimension, models):
        record_file = network_file(dimension, seed, "json", models)
        try:
            record = read_json(record_file)
            settings = settings_from_dict(record["config"], MapTrainingConfig)
        except (FileError, ValueError, LookupError, TypeError):
            settings = None
        if settings is None or replace(settings, seed=config.seed) != config:
            for old in record_file.parent.glob(f"seed_{seed}.*"):
                old.unlink()


def _check_same_config(trainings: Sequence[_Training]) -> None:
    seeds = [training.config.seed for training in trainings]
    if len(set(seeds)) < len(seeds):
        raise ValueError(f"the seeds of trainings must differ, got {seeds}")
    configs = [{**settings_to_dict(training.config), "seed": None} for training in trainings]
    for training, config in zip(trainings, configs, strict=True):
        if config != configs[0]:
            raise ValueError(
                f"{training.folder} and {trainings[0].folder} differ in more than their seeds"
            )


if __name__ == "__main__":
    if len(sys.argv) < 2 or not Path(sys.argv[1]).is_dir():
        sys.exit("name the folder of the networks, agents/map_prediction/models, then trainings")
    target, *trainings = map(Path, sys.argv[1:])
    export(target, trainings)
