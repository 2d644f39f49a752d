"""Broken mesh files give a mesh or one error that names the file."""

import io
import zipfile

import numpy as np
import pytest

pytest.importorskip("trimesh")

from plain.fuzz import cases, mutants, read_or_refuse
from plain.meshes import archive, dae, every_format, threemf

from coopmap_env.core.files import FileError
from coopmap_env.geometry.mesh_files import read_mesh


def is_read(path):
    """Whether a file was read; what it holds must be usable."""
    mesh = read_or_refuse(read_mesh, path, FileError)
    if mesh is None:
        return False
    assert len(mesh.faces) > 0
    assert np.isfinite(mesh.triangles).all()
    return True


@cases(short=300, long=10_000)
@pytest.mark.parametrize("suffix", every_format())
def test_broken_meshes_are_refused_by_name_or_read(tmp_path, suffix, n_cases):
    path = tmp_path / f"a{suffix}"
    n_read = 0
    for content in mutants(every_format()[suffix], n_cases):
        path.write_bytes(content)
        n_read += is_read(path)
    assert n_read < n_cases


MODEL = threemf(
    objects='<object id="2"><components><component objectid="1" '
    'transform="1 0 0 0 1 0 0 0 1 5 0 0"/></components></object>',
    items='<item objectid="2"/>',
)


@cases(short=300, long=10_000)
@pytest.mark.parametrize("suffix", [".3mf", ".zae"])
def test_broken_members_of_archives_are_refused_by_name_or_read(tmp_path, suffix, n_cases):
    model = zipfile.ZipFile(io.BytesIO(MODEL)).read("3D/3dmodel.model")
    name, original = {".3mf": ("3D/3dmodel.model", model), ".zae": ("a.dae", dae())}[suffix]
    path = tmp_path / f"a{suffix}"
    n_read = 0
    for content in mutants([original], n_cases):
        path.write_bytes(archive(**{name: content}))
        n_read += is_read(path)
    assert 0 < n_read < n_cases
