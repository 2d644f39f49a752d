"""A training of a map network in a folder: checkpoints, validation, resuming after an interruption.

::

    out/training.json       the record: configuration, and one row for every segment
    out/examples-*.npz      maps and truths of each family and scene
    out/checkpoint-*.pt     what the next segment depends on, after the last one
    out/map.safetensors     the network with the smallest loss on validation worlds
    out/map.onnx            the same, for predicting without torch

As in `coopmap_agents.training`, each segment depends only on its checkpoint and on its number, and
training.json is written last; before the first segment, too, so that examples belong to it.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import coopmap_agents._require_rl  # noqa: F401

# isort: split
import numpy as np
import torch
from torch.nn import functional

from coopmap_agents._record_form import checkpoint_name
from coopmap_agents.map_config import MapTrainingConfig
from coopmap_agents.map_prediction.examples import MapExamples, cell_weights
from coopmap_agents.map_prediction.model_file import save_map_network
from coopmap_agents.map_prediction.network import MapNetwork
from coopmap_agents.map_prediction.record import (
    check_same_training,
    mean_log_loss,
    new_record,
    progress_line,
    read_record,
)
from coopmap_agents.map_prediction.scores import PredictionScores, score_predictions
from coopmap_agents.map_prediction.worlds import make_world, world_examples
from coopmap_agents.record import RECORD_FILE, Record
from coopmap_agents.trainer import torch_threads
from coopmap_agents.training.checkpoints import (
    load_checkpoint,
    remove_other_checkpoints,
    save_checkpoint,
)
from coopmap_env.core.array_files import read_arrays, write_arrays
from coopmap_env.core.files import FileError, write_atomically
from coopmap_env.core.locks import folder_lock

MODEL_FILE = "map.safetensors"
ONNX_FILE = "map.onnx"
Split = dict[str, MapExamples]
"""Examples by family or scene."""


def run_map_training(
    config: MapTrainingConfig,
    out: Path,
    log: Callable[[str], None] = lambda line: None,
    command: str = "",
) -> Record:
    """Train a map network, or resume the training of a folder; gives the content of training.json.

    Parameters
    ----------
    config : MapTrainingConfig
    out : Path
        Folder. If it holds this training, that is resumed.
    log : callable, optional
        Called with a line of progress.
    command : str, optional
        Command line of the training, for the record.

    Raises
    ------
    ValueError
        If the folder holds another training, or a family or scene is unknown or not of its
        environment.
    FileError
        If the folder holds broken files; the message says what to do.
    FolderInUseError
        If another process trains in the folder.
    """
    with folder_lock(out), torch_threads(1):
        record = read_record(out)
        if record is None:
            record = new_record(config, command)
            for name in config.worlds:
                make_world(name, config, "train").close()  # wrong names are refused here
            for left in out.glob("examples-*.npz"):
                left.unlink()
            _write_record(record, out)
        check_same_training(record, config, out)
        remove_other_checkpoints(out, len(record["rows"]))
        if record["rows"] and record["rows"][-1]["steps"] >= config.total_steps:
            log(f"{out} is finished: {record['rows'][-1]['steps']:,} steps")
            return record
        train, validation = (
            {name: _examples(name, config, split, out, log) for name in config.worlds}
            for split in ("train", "validation")
        )
        return _train(config, out, record, train, validation, log)


def _examples(
    name: str, config: MapTrainingConfig, split: str, out: Path, log: Callable[[str], None]
) -> MapExamples:
    """Examples of the folder, or newly played ones."""
    path = out / f"examples-{name}-{split}.npz"
    if not path.exists():
        images, occupied, _ = world_examples(name, config, split)
        write_arrays(path, {"images": images, "occupied": occupied})
        log(f"{name}, {split}: {len(images)} maps")
    arrays = read_arrays(path, ["images", "occupied"])
    images, occupied = arrays["images"].copy(), arrays["occupied"].copy()  # they are read-only
    is_good = images.dtype == np.uint8 and occupied.dtype == np.bool_
    is_good &= images.ndim == 1 + config.network.dimension
    if not is_good or images.shape != occupied.shape or 0 in images.shape:
        raise FileError(f"{path} is broken: remove it, and its maps are played again")
    if min(images.shape[1:3]) <= config.shift:
        raise ValueError(
            f"MapTrainingConfig.shift must be less than the sides of the maps, got {config.shift} "
            f"with maps of {images.shape[1]} x {images.shape[2]} cells of {name}"
        )
    weights = [cell_weights(*example) for example in zip(images, occupied, strict=True)]
    return MapExamples(images, occupied, np.stack(weights))


def _train(
    config: MapTrainingConfig,
    out: Path,
    record: Record,
    train: Split,
    validation: Split,
    log: Callable[[str], None],
) -> Record:
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.seed)
        network = MapNetwork(config.network)
    optimizer = torch.optim.AdamW(
        network.parameters(), config.learning_rate, weight_decay=config.weight_decay
    )
    steps, rows = 0, record["rows"]
    if rows:
        steps = load_checkpoint(
            out / checkpoint_name(len(rows)), network, optimizer, rows[-1]["steps"]
        )
    while steps < config.total_steps:
        start = time.perf_counter()
        loss = _learn_segment(config, network, optimizer, train, steps, len(rows))
        steps = min(steps + config.segment_steps, config.total_steps)
        if not np.isfinite(loss):
            raise ValueError(
                f"the training diverged before {steps} steps: choose a "
                f"MapTrainingConfig.learning_rate below {config.learning_rate}"
            )
        scores = {name: asdict(validate(network, validation[name])) for name in validation}
        seconds = time.perf_counter() - start
        rows.append({"steps": steps, "loss": loss, "seconds": seconds, "validation": scores})
        save_checkpoint(out / checkpoint_name(len(rows)), network, optimizer, steps)
        losses = [mean_log_loss(row) for row in rows]
        if losses[-1] == min(losses):
            record["best"] = len(rows) - 1
            origin = {"config": record["config"], "steps": steps, "validation": scores}
            for name in (MODEL_FILE, ONNX_FILE):
                save_map_network(network, out / name, origin)
        _write_record(record, out)
        remove_other_checkpoints(out, len(rows))
        log(progress_line(record))
    return record


def _write_record(record: Record, out: Path) -> None:
    write_atomically(out / RECORD_FILE, json.dumps(record, indent=1) + "\n")


def _learn_segment(
    config: MapTrainingConfig,
    network: MapNetwork,
    optimizer: torch.optim.Optimizer,
    train: Split,
    steps: int,
    segment: int,
) -> float:
    """Learn for one segment; the mean loss of its batches."""
    rng = np.random.default_rng(np.random.SeedSequence([config.seed, segment]))
    names, losses = list(train), []
    network.train()
    for step in range(steps, min(steps + config.segment_steps, config.total_steps)):
        _set_learning_rate(optimizer, learning_rate(config, step))
        images, occupied, weights = _draw_batch(train[names[step % len(names)]], config, rng)
        loss = weighted_loss(network(images), occupied, weights)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), config.max_gradient_norm)
        optimizer.step()
        losses.append(loss.item())
        if not np.isfinite(losses[-1]):
            break
    _set_learning_rate(optimizer, config.learning_rate)  # as checkpoints have it
    network.eval()
    return float(np.mean(losses))


def _set_learning_rate(optimizer: torch.optim.Optimizer, rate: float) -> None:
    for group in optimizer.param_groups:
        group["lr"] = rate


def learning_rate(config: MapTrainingConfig, step: int) -> float:
    """Learning rate of a gradient step, counted from 0."""
    rising = (step + 1) / config.warmup_steps
    falling = 1 - step / config.total_steps
    return config.learning_rate * min(rising, 1.0) * falling


def weighted_loss(
    logits: torch.Tensor, occupied: torch.Tensor, weights: torch.Tensor
) -> torch.Tensor:
    """Mean cross-entropy (nats) of the cells of some maps, with their weights."""
    each = functional.binary_cross_entropy_with_logits(logits, occupied, reduction="none")
    return (each * weights).sum() / weights.sum().clamp(min=1.0)


def _draw_batch(
    examples: MapExamples, config: MapTrainingConfig, rng: np.random.Generator
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Some maps, turned, mirrored and shifted horizontally; images as bytes, others as float32."""
    chosen = rng.integers(len(examples.images), size=config.batch_size)
    turns, mirrored = int(rng.integers(4)), bool(rng.integers(2))
    cut = rng.integers(config.shift + 1, size=2)
    parts: list[Any] = []
    for array in examples:
        part = np.rot90(array[chosen], turns, axes=(1, 2))
        part = (part[:, ::-1] if mirrored else part)[:, cut[0] :, cut[1] :]
        parts.append(torch.from_numpy(np.ascontiguousarray(part)))
    return parts[0], parts[1].float(), parts[2]


@torch.inference_mode()
def validate(network: MapNetwork, examples: MapExamples) -> PredictionScores:
    """Scores of the predictions of a network."""
    images = torch.from_numpy(examples.images)
    predicted = [network(some).sigmoid() for some in images.split(16)]
    return score_predictions(torch.cat(predicted).numpy(), examples.occupied, examples.weights)
