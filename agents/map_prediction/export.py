"""Write the files of the map networks that ship with coopmap: for maintainers.

::

    python -m coopmap_agents.map_prediction.export results/map-planar results/map-field

copies the networks of some trainings and their records, and writes the ONNX files of all networks
that ship, as they are then. See `make map-networks`.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

from coopmap_agents.map_config import USUAL_TRAININGS
from coopmap_agents.map_prediction.model_file import convert_map_network, load_map_network
from coopmap_agents.map_prediction.predictor import shipped_path
from coopmap_agents.map_prediction.record import read_record
from coopmap_agents.map_prediction.training import MODEL_FILE
from coopmap_agents.record import RECORD_FILE
from coopmap_env.core.files import FileError, read_bytes, write_atomically


def export(trainings: Sequence[Path] = ()) -> None:
    """Copy the networks of finished trainings, and write the ONNX files of all that ship.

    Parameters
    ----------
    trainings : sequence of Path
        Folders of `run_map_training`, one for each environment at most.

    Raises
    ------
    ValueError
        If two trainings are of one environment, or one is unfinished.
    FileError
        If a file of theirs is broken.
    """
    exported = {shipped_path(_finished_dimension(folder)): folder for folder in trainings}
    if len(exported) < len(trainings):
        raise ValueError("two trainings are of the same environment: name the one that is to ship")
    for path, folder in exported.items():
        write_atomically(path, read_bytes(folder / MODEL_FILE))
        write_atomically(path.with_suffix(".json"), read_bytes(folder / RECORD_FILE))
    for usual in USUAL_TRAININGS.values():
        path = shipped_path(usual.network.dimension)
        convert_map_network(path, path.with_suffix(".onnx"))


def _finished_dimension(folder: Path) -> int:
    """Dimension of the maps of a training that has reached its steps."""
    record = read_record(folder)
    if record is None:
        raise FileError(f"{folder / RECORD_FILE}: there is no such file")
    total_steps = record["config"]["total_steps"]
    if not record["rows"] or record["rows"][-1]["steps"] < total_steps:
        raise ValueError(f"{folder} is unfinished: it has not reached {total_steps} steps")
    return load_map_network(folder / MODEL_FILE).settings.dimension


if __name__ == "__main__":
    export([Path(argument) for argument in sys.argv[1:]])
