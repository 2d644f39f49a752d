"""Broken map files: each is read, or refused by the one error that begins with its path."""

import io
import zipfile

import numpy as np
import pytest
import yaml
from plain.fuzz import cases, mutants, read_or_refuse
from plain.png import COLOUR, GRAY, GRAY_ALPHA, png
from plain.scanned_maps import FIELD_GRID, PLANAR_GRID, scanned_map

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import (
    MapFileError,
    SurfaceEstimates,
    load_map,
    load_surfaces,
    save_map,
    save_surfaces,
)
from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.planar import read_map_server

pytestmark = pytest.mark.filterwarnings("ignore:.*which map_saver writes for unknown:UserWarning")

GRAYS = np.arange(96, dtype=np.uint8).reshape(8, 12) * 2
IMAGES = [
    b"P5\n12 8\n255\n" + GRAYS.tobytes(),
    b"P5 # wide\n12 8\n65535\n" + (GRAYS * 257.0).astype(">u2").tobytes(),
    b"P2\n12 8\n190\n" + b" ".join(b"%d" % gray for gray in GRAYS.ravel()),
    b"P4\n12 8\n" + GRAYS.tobytes()[:16],
    png(12, 8, 8, GRAY, [row.tobytes() for row in GRAYS], b"\0\x07"),
    png(12, 8, 16, GRAY, [row.astype(">u2").tobytes() for row in GRAYS * 257.0]),
    png(12, 8, 8, GRAY_ALPHA, [np.repeat(row, 2).tobytes() for row in GRAYS]),
    png(12, 8, 8, COLOUR, [np.repeat(row, 3).tobytes() for row in GRAYS]),
]
YAML = b"""\
image: map.png
resolution: 0.05
origin: [-10.0, 3.5, 0.0]
negate: 0
occupied_thresh: 0.65
free_thresh: 0.196
mode: trinary
"""


def check_map(map_):
    """Raise nothing: a map that was read is one."""
    assert isinstance(map_, OccupancyMap)
    assert np.isfinite(map_.probability).all()
    assert np.isfinite(map_.entropy)
    _, means, covariances = map_.surfaces()
    assert np.isfinite(means).all()
    assert np.isfinite(covariances).all()


def check_surfaces(surfaces):
    assert isinstance(surfaces, SurfaceEstimates)
    assert np.isfinite(surfaces.means).all()
    assert np.isfinite(surfaces.covariances).all()


def is_read(path, load=load_map, check=check_map, error_type=MapFileError):
    """Whether a file was read; what it holds must be usable."""
    loaded = read_or_refuse(load, path, error_type)
    if loaded is None:
        return False
    check(loaded)
    return True


def saved(tmp_path, name, *maps):
    """Contents of the files of some maps."""
    contents = []
    for map_ in maps:
        save_map(map_, tmp_path / name)
        contents.append((tmp_path / name).read_bytes())
    return contents


def check_counts(n_read, n_cases):
    """Mutations are neither all harmless nor all fatal, or the test would show little."""
    assert 0 < n_read < n_cases


@cases(short=600, long=60_000)
def test_a_broken_map_server_yaml_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "map.yaml"
    (tmp_path / "map.png").write_bytes(IMAGES[4])
    n_read = 0
    for content in mutants([YAML], n_cases, seed=1):
        path.write_bytes(content)
        n_read += is_read(path)
        is_read(path, read_map_server, lambda scene: scene.truth, SceneError)
    check_counts(n_read, n_cases)


@cases(short=1000, long=100_000)
def test_a_broken_map_server_image_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "map.yaml"
    path.write_bytes(YAML)
    n_read = 0
    for content in mutants(IMAGES, n_cases, seed=2):
        (tmp_path / "map.png").write_bytes(content)
        n_read += is_read(path)
    check_counts(n_read, n_cases)


@cases(short=300, long=30_000)
def test_a_broken_npz_archive_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "map.npz"
    originals = saved(tmp_path, path.name, scanned_map(PLANAR_GRID), scanned_map(FIELD_GRID))
    for content in mutants(originals, n_cases, seed=3):  # checksums find nearly every one
        path.write_bytes(content)
        is_read(path)


@cases(short=600, long=60_000)
def test_a_broken_npz_member_is_read_or_refused_by_its_path(tmp_path, n_cases):
    """The archive is whole, one of its arrays is not."""
    path = tmp_path / "map.npz"
    (original,) = saved(tmp_path, path.name, scanned_map(VoxelGrid((5, 4), 0.5)))
    with zipfile.ZipFile(io.BytesIO(original)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    changed = {name: mutants([content], n_cases, seed=4) for name, content in members.items()}
    rng = np.random.default_rng(5)
    n_read = 0
    for _ in range(n_cases):
        name = rng.choice(list(members))
        with zipfile.ZipFile(path, "w") as archive:
            for member, content in members.items():
                archive.writestr(member, next(changed[name]) if member == name else content)
        n_read += is_read(path)
    check_counts(n_read, n_cases)


@cases(short=600, long=60_000)
@pytest.mark.parametrize("suffix", [".ot", ".bt"])
def test_a_broken_octomap_file_is_read_or_refused_by_its_path(tmp_path, suffix, n_cases):
    pytest.importorskip("pyoctomap")
    path = tmp_path / f"map{suffix}"
    (ours,) = saved(tmp_path, path.name, scanned_map(FIELD_GRID))
    of_others = b"\n".join(line for line in ours.split(b"\n") if not line.startswith(b"# coopmap"))
    n_read = 0
    for content in mutants([ours, of_others], n_cases, seed=6):
        path.write_bytes(content)
        n_read += is_read(path)
    check_counts(n_read, n_cases)


@cases(short=1000, long=100_000)
def test_a_broken_ply_file_is_read_or_refused_by_its_path(tmp_path, n_cases):
    path = tmp_path / "map.ply"
    originals = []
    for ascii_ in (True, False):
        save_surfaces(scanned_map(VoxelGrid((5, 4), 0.5)), path, ascii_)
        originals.append(path.read_bytes())
    n_read = 0
    for content in mutants(originals, n_cases, seed=7):
        path.write_bytes(content)
        n_read += is_read(path, load_surfaces, check_surfaces)
    check_counts(n_read, n_cases)


def test_the_originals_are_read(tmp_path):
    (tmp_path / "map.yaml").write_bytes(YAML)
    assert yaml.safe_load(YAML)["image"] == "map.png"
    for content in IMAGES:
        (tmp_path / "map.png").write_bytes(content)
        assert load_map(tmp_path / "map.yaml").grid.shape == (12, 8)
