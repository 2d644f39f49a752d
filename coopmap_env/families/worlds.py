"""The frozen worlds of a family: a hash of what each world is, and of where its team starts."""

from __future__ import annotations

import csv
import hashlib
import json
from functools import cache
from importlib import resources
from typing import Any

import numpy as np

from coopmap_env.core.files import brief
from coopmap_env.envs import MappingEnv
from coopmap_env.envs.planar import PlanarEnv
from coopmap_env.families.family import Family

N_WORLDS = {"train": 1_000, "validation": 200, "test": 200}
"""Worlds of each split that are frozen; their seeds count from 0."""
COLUMNS = ("split", "seed", "world_hash")
"""Of the files of hashes, one for each family; seeds of a split are in turn."""
DEFINITIONS = "definitions.json"
"""File beside them with the hash of each family's definition."""
HASH_DIGITS = 16
"""Hexadecimal digits of a hash: 64 bits."""


class WorldMismatchError(ValueError):
    """A world is not the one that was frozen."""


def definition_hash(family: Family) -> str:
    """SHA-256 of a family's definition."""
    text = json.dumps(family.definition, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:HASH_DIGITS]


def world_hash(env: MappingEnv[Any]) -> str:
    """SHA-256 of the true world of an environment after a reset, and of where its team stands.

    Before the first step. In a planar world of the occupied cells and the start poses; in a field
    world of the occupied voxels and the base poses.
    """
    truth = env.truth
    if isinstance(env, PlanarEnv):
        start = np.array(env.belief().pose_ids, dtype="<i8")
    else:
        poses = [(base.rotation.ravel(), base.translation) for base in truth.base_poses]
        start = np.array([np.concatenate(pose) for pose in poses], dtype="<f8")
    sha = hashlib.sha256(repr(truth.occupied.shape).encode())
    sha.update(np.packbits(truth.occupied).tobytes())
    sha.update(start.tobytes())
    return sha.hexdigest()[:HASH_DIGITS]


@cache
def frozen_hashes(name: str) -> dict[str, Any]:
    """The hashes of a family: ``definition``, and a list for each split, in the order of seeds."""
    folder = resources.files("coopmap_env.families") / "hashes"
    definitions = json.loads((folder / DEFINITIONS).read_text(encoding="utf-8"))
    hashes: dict[str, Any] = {"definition": definitions[name]}
    for row in csv.DictReader((folder / f"{name}.csv").read_text(encoding="utf-8").splitlines()):
        hashes.setdefault(row["split"], []).append(row["world_hash"])
    return hashes


def n_frozen(family: Family, split: str) -> int:
    """Number of the frozen worlds of a split."""
    return len(frozen_hashes(family.name)[split])


def check_world(family: Family, env: MappingEnv[Any], seed: int) -> None:
    """Compare the world of an environment of this family, after its reset, with the frozen one.

    Raises
    ------
    WorldMismatchError
        If it differs, or the seed is not one of a frozen world.
    """
    hashes = frozen_hashes(family.name)[env.split]
    if not isinstance(seed, int | np.integer) or not 0 <= seed < len(hashes):
        raise WorldMismatchError(
            f"the family {family.name!r} has {len(hashes)} frozen worlds in the split "
            f"{env.split!r}, from seed 0 on, and {brief(seed)} is none of them"
        )
    found = world_hash(env)
    if found != hashes[seed]:
        raise WorldMismatchError(
            f"world {seed} of the split {env.split!r} of the family {family.name!r} has the hash "
            f"{found}, and {hashes[seed]} is expected: another version of coopmap, or of a library "
            "that draws worlds"
        )
