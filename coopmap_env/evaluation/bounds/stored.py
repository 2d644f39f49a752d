"""Bounds in files, with what they are bounds of; what is read is checked in one pass.

The file is an archive of arrays: the search's settings, the certificates, the bounds that follow
from them, the choice and what it shows, and a hash of all that decides what can be viewed from
where and when. Reading it runs no code.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.array_files import read_arrays, read_texts, write_arrays
from coopmap_env.core.files import FileError, brief
from coopmap_env.core.settings import settings_from_dict, settings_to_dict
from coopmap_env.evaluation.bounds.certificate import Certificate, Views
from coopmap_env.evaluation.bounds.search import (
    BoundSearch,
    ShownBound,
    bound_shown,
    count_shown,
)

FORMAT = "coopmap bound 1"
TEXTS = ("format", "views", "search")
ARRAYS = {"bounds": "<i8", "choice": "<i8", "choice_shown": "<i8", "weights": "<u2"}


class BoundFileError(FileError):
    """A file of a bound that is missing, broken, of another world, or wrong."""


def save_bound(path: str | os.PathLike[str], found: ShownBound, views: Views) -> None:
    """Write a bound of what these views show, whole or not at all.

    Parameters
    ----------
    path : path-like
        Such as ``bound.npz``.
    found : ShownBound
    views : Views

    Raises
    ------
    ValueError
        If it is no bound of these views; see `check_bound`.
    """
    check_bound(found, views)
    texts = (FORMAT, views.digest, json.dumps(settings_to_dict(found.search)))
    arrays = (
        found.bounds,
        found.choice,
        found.choice_shown,
        np.array([certificate.weights for certificate in found.certificates]),
    )
    write_arrays(
        path,
        {name: np.array(text) for name, text in zip(TEXTS, texts, strict=True)}
        | {
            name: array.astype(kind)
            for (name, kind), array in zip(ARRAYS.items(), arrays, strict=True)
        },
    )


def load_bound(path: str | os.PathLike[str], views: Views) -> ShownBound:
    """Read a bound of what these views show, and check all of it; see `check_bound`.

    Raises
    ------
    BoundFileError
        If the file is missing, broken or too large, belongs to another world, to other cameras,
        starts, reach or scans, or states what does not follow from its certificates.
    """
    format_, digest, search = read_texts(path, TEXTS, BoundFileError)
    if format_ != FORMAT:
        raise BoundFileError(f"{path} is of format {brief(format_)}, not {FORMAT!r}")
    if digest != views.digest:
        raise BoundFileError(
            f"{path} belongs to another world, or to other cameras, starts, reach or scans: its "
            f"views have the hash {brief(digest)}, these {views.digest}"
        )
    entries = read_arrays(path, tuple(ARRAYS), BoundFileError)
    try:
        bounds, choice, choice_shown, weights = (_checked(entries, name) for name in ARRAYS)
        found = ShownBound(
            bounds,
            choice,
            choice_shown,
            tuple(Certificate(own) for own in weights),
            settings_from_dict(json.loads(search), BoundSearch),
        )
        check_bound(found, views)
    except (ValueError, RecursionError) as error:
        raise BoundFileError(f"{path}: {error}") from error
    return found


def kept_bound(path: Path, views: Views, n_scans: int) -> ShownBound:
    """The bound of n scans in a file, which is checked; one that is missing is searched and kept.

    So is one of a shorter search than the default `BoundSearch`: it holds, but it is loose, and
    efficiencies by it would be too low. How long the search was, the file says itself. Who must not
    believe that keeps files of their own.

    Raises
    ------
    BoundFileError
        See `load_bound`; or if it is of another number of scans.
    """
    if path.exists():
        kept = load_bound(path, views)
        n_kept = len(kept.bounds) - 1
        if n_kept != n_scans:
            raise BoundFileError(f"{path} has bounds of {n_kept} scans, not {n_scans}")
        if kept.search.is_as_long_as(BoundSearch()):
            return kept
    found = bound_shown(views, n_scans)
    save_bound(path, found, views)
    return found


def _checked(entries: dict[str, NDArray[Any]], name: str) -> NDArray[Any]:
    """A copy of an array; ValueError unless it is of its type and has its axes."""
    array, kind, n_axes = entries[name], ARRAYS[name], 2 if name in ("choice", "weights") else 1
    if array.dtype != np.dtype(kind) or array.ndim != n_axes:
        raise ValueError(
            f"{name} must be an array of {np.dtype(kind)} with {n_axes} axes, got "
            f"{brief(array.dtype)} of shape {array.shape}"
        )
    return np.array(array, order="C")


def check_bound(found: ShownBound, views: Views) -> None:
    """Compute a bound again from its certificates, one pass over all views for each, and compare.

    What the choice shows is counted again, too, and whether robots can be there in time.

    Raises
    ------
    ValueError
        If something is not what it says.
    """
    n_scans, n_robots = len(found.bounds) - 1, len(views.earliest)
    if not found.certificates:
        raise ValueError("a bound needs at least one certificate")
    each = [certificate.bounds(views, n_scans) for certificate in found.certificates]
    _compare("bounds", found.bounds, np.min(each, axis=0), "follow from the certificates")
    if found.choice.shape != (n_scans, n_robots):
        raise ValueError(
            f"the choice must be of shape {(n_scans, n_robots)}, got {found.choice.shape}"
        )
    if not views.can_take(found.choice):
        raise ValueError("the choice has poses where robots cannot be at their scans")
    _compare("choice_shown", found.choice_shown, count_shown(views, found.choice), "are shown")


def _compare(name: str, stated: NDArray[np.int64], right: NDArray[np.int64], what: str) -> None:
    if not np.array_equal(stated, right):
        raise ValueError(f"{name} {brief(stated.tolist())} are stated, {right.tolist()} {what}")
