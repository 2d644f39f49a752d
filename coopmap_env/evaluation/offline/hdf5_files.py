"""Episodes in groups of HDF5 files, laid out as in Minari's ``main_data.hdf5``.

========================================  ==================================================
in the group of an episode                content
========================================  ==================================================
``observations/KEY``                      (T + 1, ...)
``actions``                               (T, k)
``rewards``                               (T,) float64
``terminations``, ``truncations``         (T,) bool
``infos/KEY``                             (T + 1, n_robots)
attributes ``id, seed, total_steps``      integers
========================================  ==================================================

An array that is larger than a few numbers is one chunk, packed with gzip: Minari's own writer packs
nothing, and maps shrink to a few percent.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import FileError, brief
from coopmap_env.core.limits import check_bytes
from coopmap_env.evaluation.offline.episode import Arrays, RecordedEpisode

FORMAT_BOUNDS = ("v110", "v110")
"""Versions of HDF5 whose structures are written: chunks without an index, small headers."""
PACKED_FROM = 512
"""Bytes from which on an array is packed."""
GZIP_LEVEL = 6


@contextmanager
def open_hdf5(path: str | os.PathLike[str], mode: str) -> Iterator[Any]:
    """An HDF5 file.

    Parameters
    ----------
    path : path-like
    mode : {"r", "w"}

    Raises
    ------
    ImportError
        With the pip command, if h5py is not installed (extra ``record``).
    """
    h5py = import_optional("h5py", "record")
    with h5py.File(os.fspath(path), mode, libver=FORMAT_BOUNDS) as file:
        yield file


def write_episode(group: Any, episode: RecordedEpisode) -> None:
    """Write an episode into an empty group."""
    group.attrs["seed"] = episode.seed
    group.attrs["total_steps"] = len(episode)
    for name in ("observations", "infos"):
        for key, array in getattr(episode, name).items():
            _write(group, f"{name}/{key}", array)
    for name in ("actions", "rewards", "terminations", "truncations"):
        _write(group, name, getattr(episode, name))


def _write(group: Any, name: str, array: NDArray[Any]) -> None:
    if array.nbytes < PACKED_FROM:
        group.create_dataset(name, data=array)
        return
    group.create_dataset(
        name, data=array, chunks=array.shape, compression="gzip", compression_opts=GZIP_LEVEL,
        shuffle=True,
    )  # fmt: skip


def read_episode(
    path: Path,
    name: str,
    observation_space: spaces.Dict,
    action_space: spaces.Space[Any],
    error_type: type[FileError] = FileError,
) -> RecordedEpisode:
    """Read an episode of a file.

    Parameters
    ----------
    path : Path
    name : str
        Of its group.
    observation_space : gymnasium.spaces.Dict
    action_space : gymnasium.spaces.Space
        Types and shapes that its arrays must have.
    error_type : type

    Raises
    ------
    error_type
        With the file, if it is missing, broken or too large, or refers to other files.
    ImportError
        If h5py is not installed.
    """
    if not path.is_file():
        raise error_type(f"{path}: there is no such file")
    try:
        with open_hdf5(path, "r") as file:
            return _read_episode(_child(file, name), observation_space, action_space)
    except ImportError:
        raise
    except Exception as error:  # whatever h5py raises for broken files
        raise error_type(f"{path}: {name} cannot be read: {error!s:.500}") from error


def _read_episode(
    group: Any, observation_space: spaces.Dict, action_space: spaces.Space[Any]
) -> RecordedEpisode:
    seed, n_steps = (int(group.attrs[key]) for key in ("seed", "total_steps"))
    if seed < 0 or n_steps < 1:
        raise ValueError(f"expected a seed of at least 0 and steps, got {seed} and {n_steps}")
    observed, reported = _child(group, "observations"), _child(group, "infos")
    if sorted(observed) != sorted(observation_space):
        raise ValueError(f"expected the observations {sorted(observation_space)}")
    observations: Arrays = {
        key: _read(observed, key, (n_steps + 1, *(space.shape or ())), space.dtype)
        for key, space in observation_space.items()
    }
    actions = _read(group, "actions", (n_steps, *(action_space.shape or ())), action_space.dtype)
    infos = {key: _read(reported, key, (n_steps + 1, None), None) for key in reported}
    return RecordedEpisode(
        seed,
        observations,
        actions,
        _read(group, "rewards", (n_steps,), np.dtype(np.float64)),
        _read(group, "terminations", (n_steps,), np.dtype(np.bool_)),
        _read(group, "truncations", (n_steps,), np.dtype(np.bool_)),
        infos,
    )


def _child(group: Any, name: str) -> Any:
    """An entry of a group that is in this file; a link may lead to any other file."""
    h5py = import_optional("h5py", "record")
    if name not in group or not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is missing, or in another file")
    return group[name]


def _read(
    group: Any, name: str, shape: tuple[int | None, ...], dtype: np.dtype[Any] | None
) -> NDArray[Any]:
    """An array of numbers. None stands for any length, and for any type."""
    data = _child(group, name)
    found = tuple(data.shape)
    fits = [n in (None, m) for n, m in zip(shape, found, strict=False)]
    if len(found) != len(shape) or not all(fits):
        raise ValueError(f"{name}: expected the shape {brief(shape)}, got {brief(found)}")
    if data.dtype.kind not in "biuf" or (dtype is not None and data.dtype != dtype):
        raise ValueError(f"{name}: expected the type {brief(dtype)}, got {brief(data.dtype)}")
    if data.is_virtual or data.external:
        raise ValueError(f"{name} is in another file")
    check_bytes(data.size * data.dtype.itemsize, name)
    array: NDArray[Any] = data[()]
    return array
