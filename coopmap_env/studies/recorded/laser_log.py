"""Planar laser logs in g2o files, zipped as `rtb-data` brings them.

A g2o file is text, one record a line. Three kinds occur:

===========  ====================================================================================
VERTEX_SE2   id x y heading: a pose of the robot
EDGE_SE2     a measured motion between two poses; not read, see `read_laser_log`
ROBOTLASER1  type, start angle, field of view, step, max range, accuracy, remission mode, n,
             n ranges, m, m remissions, laser pose (x y heading), robot pose (x y heading), ...
===========  ====================================================================================
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

RECORD = "ROBOTLASER1"
HEADER = 9
"""Words of a record before the ranges, its name included."""


class LaserLogError(ValueError):
    """A file holds no usable log; the message names the file, and the line if it is to blame."""


@dataclass(frozen=True, eq=False)
class LaserLog:
    """What a planar laser recorded along its way, with the poses of the laser."""

    ranges: NDArray[np.float64]
    """Shape (n, n_beams), metres; `max_range` or more is no return."""
    bearings: NDArray[np.float64]
    """Shape (n_beams,), radians from the laser's heading, from +x to +y."""
    poses: NDArray[np.float64]
    """Shape (n, 3): x, y (metres) and heading (radians) in the world frame."""
    max_range: float
    """Metres."""

    @property
    def step(self) -> float:
        """Radians between two beams."""
        return float(self.bearings[1] - self.bearings[0])


def read_laser_log(path: Path) -> LaserLog:
    """Read the laser records of a zipped g2o file.

    The poses are those of the laser in its own records, as they are: no graph is optimised. Those
    of Killian Court are the optimum of its graph already (see `killian`).

    Parameters
    ----------
    path : Path
        ``NAME.zip`` with the member ``NAME``.

    Raises
    ------
    LaserLogError
        If the file is no zip or lacks its member, a record is cut short or not finite, records
        differ in their beams, or there is none.
    """
    ranges, poses, heads = [], [], set()
    for number, line in _lines(path):
        words = line.split()
        if not words or words[0] != RECORD:
            continue
        try:
            head, values, pose = _record(words)
        except ValueError as error:
            raise LaserLogError(f"{path}, line {number}: {error}") from None
        heads.add(head)
        if len(heads) > 1:
            raise LaserLogError(
                f"{path}, line {number}: start, step, max range and number of beams are {head} "
                f"and were {next(iter(heads - {head}))}: one log is one laser"
            )
        ranges.append(values)
        poses.append(pose)
    if not ranges:
        raise LaserLogError(f"{path}: no {RECORD} record")
    start, step, max_range, n_beams = heads.pop()
    return LaserLog(
        np.array(ranges),
        start + step * np.arange(n_beams, dtype=np.float64),
        np.array(poses),
        max_range,
    )


def _lines(path: Path) -> Iterator[tuple[int, str]]:
    """Lines of the archive's member, numbered from 1."""
    try:
        with zipfile.ZipFile(path) as archive:
            text = archive.read(path.stem).decode("ascii", errors="replace")
    except (OSError, zipfile.BadZipFile) as error:
        raise LaserLogError(f"{path}: not a zip file that can be read: {error}") from error
    except KeyError:
        raise LaserLogError(f"{path}: has no member {path.stem}") from None
    return enumerate(text.splitlines(), start=1)


def _record(
    words: list[str],
) -> tuple[tuple[float, float, float, int], NDArray[np.float64], NDArray[np.float64]]:
    """(start, step, max range, n), ranges (n,) and laser pose (3,) of a record."""
    if len(words) < HEADER:
        raise ValueError(f"{RECORD} needs {HEADER} words before its ranges, got {len(words)}")
    n = int(words[HEADER - 1])
    if n < 2:
        raise ValueError(f"{RECORD} needs two beams or more, got {n}")
    remissions = HEADER + n
    pose = remissions + 1 + (int(words[remissions]) if len(words) > remissions else 0)
    if len(words) < pose + 3:
        raise ValueError(f"{RECORD} of {n} beams is cut short after {len(words)} words")
    head = np.array([words[2], words[4], words[5]], dtype=np.float64)
    values = np.array(words[HEADER:remissions], dtype=np.float64)
    place = np.array(words[pose : pose + 3], dtype=np.float64)
    for name, numbers in (("header", head), ("range", values), ("laser pose", place)):
        if not np.isfinite(numbers).all():
            raise ValueError(f"{RECORD} has a {name} that is not finite")
    if (values < 0).any() or head[1] <= 0 or head[2] <= 0:
        raise ValueError(f"{RECORD} needs ranges >= 0, a step and a max range > 0")
    return (float(head[0]), float(head[1]), float(head[2]), n), values, place
