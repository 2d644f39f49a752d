"""Weights by name, as arrays or as tensors: checked against metadata; needs no torch."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np


def check_shapes(weights: Mapping[str, Any], needed: Mapping[str, tuple[int, ...]]) -> None:
    """Check the shapes of weights, before the network is made.

    A short text of metadata can describe a large network.

    Raises
    ------
    ValueError
        With the first that differs.
    """
    shapes = {name: tuple(values.shape) for name, values in weights.items()}
    if shapes != needed:
        name = min(key for key in shapes | {**needed} if shapes.get(key) != needed.get(key))
        raise ValueError(
            "the weights do not belong to the metadata: "
            f"{name} has the shape {shapes.get(name)}, not {needed.get(name)}"
        )


def check_values(weights: Mapping[str, Any]) -> None:
    """Check types and values.

    Raises
    ------
    ValueError
        With the first that are not of type float32, or not finite.
    """
    for name, values in weights.items():
        if str(values.dtype).removeprefix("torch.") != "float32":
            raise ValueError(f"the weights {name} must be of type float32, not {values.dtype}")
        if not np.isfinite(np.asarray(values)).all():
            raise ValueError(f"the weights {name} must be finite numbers")


def fingerprint_of(parts: Iterable[bytes]) -> str:
    """Hash of weights, or of files of them, in this order."""
    sha = hashlib.sha256()
    for part in parts:
        sha.update(part)
    return sha.hexdigest()
