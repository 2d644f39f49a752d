"""Broken laser logs: each is read, or refused by the one error that begins with its path."""

import zipfile

import numpy as np
from plain.fuzz import cases, mutants, read_or_refuse

from coopmap_env.studies.recorded.killian import scan_from_log
from coopmap_env.studies.recorded.laser_log import LaserLogError, read_laser_log

LOG = b"""\
VERTEX_SE2 0 7 7 7
ROBOTLASER1 0 -1.5 3.0 0.5 50.0 0.1 0 4 1.25 2.5 inf 51.06 0 1.0 2.0 0.5 9 9 9 0 0 0 0 0 1e9 h 0
EDGE_SE2 0 1 1 0 0 500 0 0 500 0 5000
ROBOTLASER1 0 -1.5 3.0 0.5 50.0 0.1 0 4 3.0 0.0 4.0 5.5 2 8 8 -1.0 0.0 3.0 9 9 9 0 0 0 0 0 1e9 h 0
"""


def is_read(path):
    """Whether a log was read; what it holds must be usable."""
    log = read_or_refuse(read_laser_log, path, LaserLogError)
    if log is None:
        return False
    assert np.isfinite(log.poses).all()
    assert log.ranges.shape == (len(log.poses), len(log.bearings))
    scan = scan_from_log(log, 0, usable_range=min(30.0, log.max_range))
    assert np.isfinite(scan.points).all()
    return True


@cases(short=2500, long=400_000)
def test_a_broken_laser_record_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "walk.g2o.zip"
    n_read = 0
    for content in mutants([LOG], n_cases, seed=1):
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("walk.g2o", content)
        n_read += is_read(path)
    assert 0 < n_read < n_cases


@cases(short=2500, long=400_000)
def test_a_broken_archive_of_a_log_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "walk.g2o.zip"
    originals = []
    for method in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_LZMA):
        with zipfile.ZipFile(path, "w", method) as archive:
            archive.writestr("walk.g2o", LOG)
        originals.append(path.read_bytes())
    for content in mutants(originals, n_cases, seed=2):  # checksums find nearly every one
        path.write_bytes(content)
        is_read(path)
