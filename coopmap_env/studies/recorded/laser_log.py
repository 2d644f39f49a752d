"""Planar laser logs in zipped g2o files, as `rtb-data` distributes them.

A g2o file is text with one record per line. Three kinds occur:

===========  ====================================================================================
VERTEX_SE2   id x y heading: a pose of the robot
EDGE_SE2     a measured motion between two poses; not read, see `read_laser_log`
ROBOTLASER1  type, start angle, field of view, step, max range, accuracy, remission mode, n,
             n ranges, m, m remissions, laser pose (x y heading), robot pose (x y heading), ...
===========  ====================================================================================

Ranges that are no distances are those of REP 117: ``inf`` no return, ``-inf`` too close to measure,
``nan`` no valid measurement.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.archives import read_zip_members
from coopmap_env.core.files import FileError, brief
from coopmap_env.core.limits import check_cells

LASER_RECORD = "ROBOTLASER1"
N_HEADER_WORDS = 9
"""Words of a record before the ranges, including its name."""
MAX_RECORD_BYTES = 1 << 20
"""Length of a record: 100,000 beams."""
_RECORD = re.compile(LASER_RECORD.encode() + rb"(?!\S)[^\r\n]*")


class LaserLogError(FileError):
    """A file contains no usable log; the message names the file, and the line where it applies."""


@dataclass(frozen=True, eq=False)
class LaserLog:
    """Scans of a planar laser along its path, with the poses of the laser."""

    ranges: NDArray[np.float64]
    """Shape (n, n_beams), metres; `max_range` or more means no return, ``inf`` included. NaN and
    ``-inf`` are no measurements."""
    bearings: NDArray[np.float64]
    """Shape (n_beams,), radians from the laser's heading, from +x to +y."""
    poses: NDArray[np.float64]
    """Shape (n, 3): x, y (metres) and heading (radians) in the world frame."""
    max_range: float
    """Metres."""

    @property
    def angle_increment(self) -> float:
        """Radians between two beams."""
        return float(self.bearings[1] - self.bearings[0])


def read_laser_log(path: str | os.PathLike[str]) -> LaserLog:
    """Read the laser records of a zipped g2o file.

    The poses are those of the laser records; no pose graph is optimised. The poses of Killian Court
    are the optimum of its graph already (see `killian`).

    Parameters
    ----------
    path : path
        ``NAME.zip`` with the member ``NAME``.

    Raises
    ------
    LaserLogError
        If the file is missing, no zip archive or lacks its member, a record is cut short, broken
        or too long, records differ in their beams, there is no record, or there are more ranges
        than the limit of cells (`coopmap_env.core.limits`).
    """
    ranges: list[NDArray[np.float64]] = []
    poses: list[NDArray[np.float64]] = []
    headers: set[tuple[float, float, float, int]] = set()
    for number, line in _find_records(path):
        try:
            header, values, pose = _parse_record(line)
            check_cells((len(ranges) + 1, len(values)), "the log")
        except ValueError as error:
            raise LaserLogError(f"{path}, line {number}: {error}") from None
        headers.add(header)
        if len(headers) > 1:
            raise LaserLogError(
                f"{path}, line {number}: start, step, max range and number of beams are {header} "
                f"and were {next(iter(headers - {header}))}: one log is one laser"
            )
        ranges.append(values)
        poses.append(pose)
    if not ranges:
        raise LaserLogError(f"{path}: no {LASER_RECORD} record")
    start, step, max_range, n_beams = headers.pop()
    return LaserLog(
        np.array(ranges),
        start + step * np.arange(n_beams, dtype=np.float64),
        np.array(poses),
        max_range,
    )


def _find_records(path: str | os.PathLike[str]) -> Iterator[tuple[int, str]]:
    """Lines of the archive's member that are laser records, and their numbers from 1.

    No other line is split off: some kilobytes of an archive may hold 10**9 of them.
    """
    name = Path(path).stem
    content = read_zip_members(path, [name], LaserLogError)[name]
    number, counted = 1, 0
    for match in _RECORD.finditer(content):
        number, counted = number + content.count(b"\n", counted, match.start()), match.start()
        if match.end() - match.start() > MAX_RECORD_BYTES:
            raise LaserLogError(f"{path}, line {number}: longer than {MAX_RECORD_BYTES} bytes")
        line_start = content.rfind(b"\n", 0, match.start()) + 1
        if not content[line_start : match.start()].strip():
            yield number, match[0].decode("ascii", errors="replace")


def _parse_record(
    line: str,
) -> tuple[tuple[float, float, float, int], NDArray[np.float64], NDArray[np.float64]]:
    """(start, step, max range, n), ranges (n,) and laser pose (3,) of a record."""
    words = line.split()
    if len(words) < N_HEADER_WORDS:
        raise ValueError(
            f"{LASER_RECORD} needs {N_HEADER_WORDS} words before its ranges, got {len(words)}"
        )
    n = _count(words[N_HEADER_WORDS - 1])
    if n < 2:
        raise ValueError(f"{LASER_RECORD} needs two beams or more, got {n}")
    remissions = N_HEADER_WORDS + n
    pose = remissions + 1 + (_count(words[remissions]) if len(words) > remissions else 0)
    if len(words) < pose + 3:
        raise ValueError(f"{LASER_RECORD} of {n} beams is cut short after {len(words)} words")
    header = np.array([words[2], words[4], words[5]], dtype=np.float64)
    values = np.array(words[N_HEADER_WORDS:remissions], dtype=np.float64)
    laser_pose = np.array(words[pose : pose + 3], dtype=np.float64)
    for name, numbers in (("header", header), ("laser pose", laser_pose)):
        if not np.isfinite(numbers).all():
            raise ValueError(f"{LASER_RECORD} has a {name} that is not finite")
    if (np.isfinite(values) & (values < 0)).any() or header[1] <= 0 or header[2] <= 0:
        raise ValueError(f"{LASER_RECORD} needs ranges >= 0, a step and a max range > 0")
    if max(abs(header[0]), header[1]) > 2 * math.pi:
        raise ValueError(
            f"{LASER_RECORD} needs a start and a step in radians of at most a full turn, got "
            f"{header[0]} and {header[1]}"
        )
    return (float(header[0]), float(header[1]), float(header[2]), n), values, laser_pose


def _count(word: str) -> int:
    if not re.fullmatch("[0-9]{1,9}", word):
        raise ValueError(f"{LASER_RECORD} needs a number of values, got {brief(word)}")
    return int(word)
