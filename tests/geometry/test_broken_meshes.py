"""Mesh files that are cut short, broken or too large: one error with the reason."""

import json
import re
import zipfile

import pytest

pytest.importorskip("trimesh")

from plain.meshes import PLY, archive, dae, every_format, exported, gltf, refusal, threemf

from coopmap_env.core.files import FileError
from coopmap_env.geometry.mesh_files import read_mesh


@pytest.mark.parametrize("suffix", every_format())
def test_a_file_that_is_cut_short_is_never_half_a_mesh(read, suffix):
    for content in every_format()[suffix]:
        for fraction in (0.0, 0.3, 0.6, 0.8, 0.9, 0.97):
            try:
                mesh = read(f"a{suffix}", content[: int(fraction * len(content))])
            except FileError:
                continue
            # a text that ends between two lines of faces looks like a whole one
            assert suffix == ".obj"
            assert len(mesh.faces) < 4


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.stl", b"", "there are 0"),
        ("a.stl", bytes(80) + b"\xff\xff\xff\xff" + bytes(50), "4,294,967,295 triangles"),
        ("a.stl", "solid a\nfacet\nvertex 0 0 x\nendfacet\nendsolid", "a facet must"),
        ("a.stl", bytes(84), "no triangles"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "names vertex 3"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nf -1 -2 -3\nv 0 1 0\n", "line 3: a face names a vertex"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "counted from 1"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 0,5 1 0\nf 1 2 3\n", "0,5"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n", "not nan"),
        ("a.obj", "v 0 0 0\nv 1 0 0\nv 1e300 1 0\nf 1 2 3\n", "below 1e.09 m, not 1e.300"),
        ("a.obj", "v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("a.ply", PLY.replace("vertex 5", "vertex 99999999999999"), "more than the limit"),
        ("a.ply", PLY.replace("face 2", "face 3"), "cut short"),
        ("a.ply", PLY.replace("3 0 1 4", "3 0 1 5"), "names vertex 5"),
        ("a.ply", PLY.replace("property double x", "property half x"), "one of the types"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n", "there are 3 lines"),
        ("a.off", "OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 99999999999999999999\n", "a face"),
        ("a.dae", dae()[:-40], "line 1[0-9], column"),
        ("a.dae", b"<!DOCTYPE a [<!ENTITY b 'c'>]>" + dae()[22:], "document types"),
        ("a.dae", dae('<unit meter="-1"/>'), "unit must be above 0 m, not '-1'"),
        ("a.dae", dae("<up_axis>UP</up_axis>"), "up_axis must be one of X_UP, Y_UP, Z_UP"),
        ("a.dae", dae(nodes='<node><instance_geometry url="#h"/></node>'), "0 elements geometry"),
        ("a.dae", dae(nodes='<node><instance_controller url="#c"/></node>'), "skins"),
        ("a.dae", dae(nodes='<node id="n"><instance_node url="#n"/></node>'), "20,000 nodes"),
        ("a.dae", dae().replace(b"1 2 3</p>", b"1 2 9</p>"), "names vertex 9"),
        ("a.dae", dae().replace(b'"#a" count="4"', b'"#a" count="4000000"'), "12 numbers"),
        ("a.3mf", b"PK", "zip"),
        ("a.3mf", archive(**{"a.txt": "b"}), "no model"),
        ("a.zae", archive(zipfile.ZIP_BZIP2, **{"a.dae": dae()}), "packed with bzip2"),
        ("a.3mf", archive(zipfile.ZIP_BZIP2, **{"3D/3dmodel.model": ""}), "packed with bzip2"),
        ("a.3mf", threemf('unit="ell"'), "unit must be one of"),
        ("a.3mf", threemf(items='<item objectid="7"/>'), "object '7' does not exist"),
        ("a.glb", exported("glb")[:-4], "is it cut"),
        ("a.gltf", gltf().replace(b"data:application", b"http://example.org/"), "in the folder"),
        ("a.gltf", gltf().replace(b'"uri":"data:', b'"uri":"../data:'), "in the folder"),
        ("a.gltf", gltf().replace(b'"version":"2.0"', b'"version":"1.0"'), "version"),
        ("a.gltf", b'{"extensionsRequired":["KHR_draco_mesh_compression"],' + gltf()[1:], "draco"),
        ("a.gltf", b"[" * 100_000, "recursion|expected"),
        ("a.gltf", gltf().replace(b'"count":12', b'"count":12000000000'), "more than the limit"),
        ("a.gltf", b'{"asset":[]}', "structure is not that of the format"),
        ("a.stl", "version https://git-lfs.github.com/spec/v1\nsize 1\n", "lfs pull"),
        ("a.zip", b"PK", "ending in .stl"),
        ("a", b"", "ending in .stl"),
    ],
)  # fmt: skip
def test_a_broken_mesh_is_refused_with_the_reason(read, name, content, reason):
    assert re.search(reason, refusal(read, name, content))


def test_a_few_lines_cannot_stand_for_gigabytes_of_copies(read):
    doubled = "".join(
        f'<object id="{k}"><components><component objectid="{k - 1}"/>'
        f'<component objectid="{k - 1}"/></components></object>'
        for k in range(2, 40)
    )
    content = threemf(objects=doubled, items='<item objectid="39"/>')
    assert "20,000 nodes" in refusal(read, "a.3mf", content)


def test_an_archive_that_unpacks_to_gigabytes_is_refused_before_it_is(read, monkeypatch):
    monkeypatch.setenv("COOPMAP_MAX_BYTES", "1000000")
    content = archive(**{"3D/3dmodel.model": "<model>" + " " * 200_000 + "</model>"})
    assert len(content) < 1000
    assert "COOPMAP_MAX_BYTES" in refusal(read, "a.3mf", content)


def test_a_buffer_beside_the_file_that_is_too_short_is_refused(read):
    header = json.loads(gltf())
    header["buffers"][0]["byteLength"] += 1000
    assert "fewer than it says" in refusal(read, "a.gltf", json.dumps(header))


def test_a_mesh_that_is_not_there_says_so(tmp_path):
    for path in (tmp_path / "a.stl", tmp_path / "b\0.stl"):
        with pytest.raises(FileError, match=r"[ab].*\.stl"):
            read_mesh(path)
    (tmp_path / "c.stl").mkdir()
    with pytest.raises(FileError, match=r"c\.stl"):
        read_mesh(tmp_path / "c.stl")
