import json
import re
import struct
import zipfile

import numpy as np
import pytest

pytest.importorskip("trimesh")

from plain.meshes import (
    DAE_NODES,
    FACES,
    VERTICES,
    archive,
    dae,
    every_format,
    exported,
    gltf,
    threemf,
)

from coopmap_env.core.files import FileError
from coopmap_env.geometry.mesh_files import read_mesh

SIZE = np.array([2.0, 3.0, 4.0])


@pytest.fixture
def read(tmp_path):
    """Write a file and read it as a mesh."""

    def read(name, content, **options):
        path = tmp_path / name
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        return read_mesh(path, **options)

    return read


def refusal(read, name, content):
    """Message of the error of a broken file, which must begin with its path."""
    with pytest.raises(FileError) as caught:
        read(name, content)
    message = str(caught.value)
    assert f"/{name}" in message.split(": ")[0]
    assert len(message) < 1000
    return message


TURNED = VERTICES @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # y of the file is up


@pytest.mark.parametrize("suffix", every_format())
def test_every_format_gives_the_same_triangles(read, suffix):
    expected = TURNED if suffix in (".gltf", ".glb") else VERTICES
    for content in every_format()[suffix]:
        mesh = read(f"a{suffix.upper()}", content)
        np.testing.assert_allclose(mesh.triangles, expected[FACES], atol=1e-6)
        assert mesh.volume == pytest.approx(4.0)


@pytest.mark.parametrize(
    ("asset", "size"),
    [
        ('<unit meter="0.001" name="millimeter"/><up_axis>Z_UP</up_axis>', SIZE / 1000),
        ('<unit name="inch" meter="0.0254"/><up_axis>Z_UP</up_axis>', SIZE * 0.0254),
        ('<unit meter="1e-2"/><up_axis> Z_UP </up_axis>', SIZE / 100),
        ("<unit/><up_axis>Z_UP</up_axis>", SIZE),
        ("<up_axis>Z_UP</up_axis>", SIZE),
    ],
)
def test_a_dae_is_scaled_by_its_unit(read, asset, size):
    for in_urdf in (False, True):
        np.testing.assert_allclose(read("a.dae", dae(asset), in_urdf=in_urdf).extents, size)


@pytest.mark.parametrize(
    ("asset", "tip"),
    [
        ("<up_axis>Z_UP</up_axis>", [0, 0, 4]),
        ("<up_axis>Y_UP</up_axis>", [0, -4, 0]),
        ("", [0, -4, 0]),  # the specification's default
        ("<up_axis>X_UP</up_axis>", [0, -4, 0]),
    ],
)
def test_a_dae_stands_as_its_up_axis_says_but_in_urdfs_as_its_numbers_do(read, asset, tip):
    mesh = read("a.dae", dae(asset))
    np.testing.assert_allclose(mesh.vertices[3], tip, atol=1e-12)
    assert mesh.volume == pytest.approx(4.0)
    np.testing.assert_allclose(read("a.dae", dae(asset), in_urdf=True).vertices, VERTICES)


def test_x_up_puts_x_up(read):
    np.testing.assert_allclose(
        read("a.dae", dae("<up_axis>X_UP</up_axis>")).vertices[:3],
        [[0, 0, 0], [0, 0, 2], [-3, 0, 0]],
        atol=1e-12,
    )


def test_nodes_of_a_dae_place_their_geometries_in_its_unit(read):
    nodes = (
        "<node><translate>10 0 0</translate><rotate>0 0 1 90</rotate><scale>2 1 1</scale>"
        f'<node id="n">{DAE_NODES}</node></node><node><instance_node url="#n"/></node>'
    )
    mesh = read("a.dae", dae('<unit meter="0.1"/><up_axis>Z_UP</up_axis>', nodes))
    parts = sorted(mesh.split(), key=lambda part: part.bounds[0, 0])
    np.testing.assert_allclose(parts[0].bounds, [[0, 0, 0], [0.2, 0.3, 0.4]], atol=1e-12)
    np.testing.assert_allclose(parts[1].bounds, [[0.7, 0, 0], [1, 0.4, 0.4]], atol=1e-12)


def test_geometries_of_a_dae_may_have_the_same_ids_inside(read):
    start, end = dae().index(b"<geometry"), dae().index(b"</library_geometries>")
    geometry = dae()[start:end]
    other = geometry.replace(b'id="g"', b'id="h"').replace(b"0 0 4<", b"0 0 9<")
    nodes = DAE_NODES + DAE_NODES.replace("#g", "#h")
    content = dae(nodes=nodes)[:end] + other + dae(nodes=nodes)[end:]
    assert read("a.dae", content).volume == pytest.approx(4.0 + 9.0)
    assert "2 elements geometry" in refusal(read, "a.dae", dae()[:end] + geometry + dae()[end:])


def test_a_dae_needs_no_namespace(read):
    plain = dae().replace(b' xmlns="http://www.collada.org/2005/11/COLLADASchema"', b"")
    np.testing.assert_allclose(read("a.dae", plain).vertices, VERTICES)


@pytest.mark.parametrize(
    ("primitive", "area"),
    [
        ('<polylist count="1">{input}<vcount>4</vcount><p>0 1 2 3</p></polylist>', 1.0),
        ('<polylist count="2">{input}<vcount>3 4</vcount><p>0 1 2 0 1 2 3</p></polylist>', 1.5),
        ("<polygons>{input}<p>0 1 2 3</p></polygons>", 1.0),
        ("<tristrips>{input}<p>0 1 3 2</p></tristrips>", 1.0),
        ("<trifans>{input}<p>0 1 2 3</p></trifans>", 1.0),
        ("<lines>{input}<p>0 1 2 3</p></lines><triangles>{input}<p>0 1 2</p></triangles>", 0.5),
    ],
)
def test_polygons_strips_and_fans_of_a_dae_become_triangles(read, primitive, area):
    start, end = dae().index(b"<triangles"), dae().index(b"</mesh>")
    source = '<input semantic="VERTEX" source="#v" offset="0"/>'
    content = dae()[:start] + primitive.format(input=source).encode() + dae()[end:]
    content = content.replace(b"0 0 0 2 0 0 0 3 0 0 0 4", b"0 0 0 1 0 0 1 1 0 0 1 0")
    assert read("a.dae", content).area == pytest.approx(area)


@pytest.mark.parametrize(
    ("unit", "size"),
    [
        ("", SIZE / 1000),
        ('unit="micron"', SIZE / 1e6),
        ('unit="centimeter"', SIZE / 100),
        ('unit="inch"', SIZE * 0.0254),
        ('unit="foot"', SIZE * 0.3048),
        ('unit="meter"', SIZE),
    ],
)
def test_a_3mf_is_scaled_by_its_unit(read, unit, size):
    np.testing.assert_allclose(read("a.3mf", threemf(unit)).extents, size)


def test_components_and_items_of_a_3mf_are_placed(read):
    objects = (
        '<object id="2"><components><component objectid="1" transform="1 0 0 0 1 0 0 0 1 5 0 0"/>'
        "</components></object>"
    )
    items = '<item objectid="1"/><item objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 0 0"/>'
    mesh = read("a.3mf", threemf(objects=objects, items=items))
    np.testing.assert_allclose(mesh.bounds, [[-3, 0, 0], [2, 7, 4]], atol=1e-12)
    assert mesh.volume == pytest.approx(8.0)


def test_nodes_of_a_gltf_place_their_meshes_with_y_up(read):
    header = json.loads(gltf())
    header["nodes"] = [
        {"children": [1], "translation": [0, 10, 0], "scale": [2, 2, 2]},
        {"mesh": 0, "rotation": [0, 0.5**0.5, 0, 0.5**0.5]},
    ]
    header["scenes"] = [{"nodes": [0]}]
    header["scene"] = 0
    mesh = read("a.gltf", json.dumps(header))
    # a quarter turn about the file's y takes its x to -z and its z to x; then z is up
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 10], [8, 4, 16]], atol=1e-6)


def test_strips_and_quantised_positions_of_a_gltf_are_read(read, tmp_path):
    corners = np.array([[0, 0, 0], [127, 0, 0], [0, 127, 0], [127, 127, 0]], np.int8).tobytes()
    header = {
        "asset": {"version": "2.0"},
        "extensionsRequired": ["KHR_mesh_quantization"],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"mode": 5, "attributes": {"POSITION": 0}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5120, "count": 4, "type": "VEC3", "normalized": True}
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 12}],
        "buffers": [{"byteLength": 12, "uri": "c%20d.bin"}],
    }
    with pytest.raises(FileError, match="there is no such file"):
        read("a.gltf", json.dumps(header))
    (tmp_path / "c d.bin").write_bytes(corners)
    mesh = read("a.gltf", json.dumps(header))
    assert mesh.area == pytest.approx(1.0)
    np.testing.assert_allclose(mesh.bounds, [[0, 0, 0], [1, 0, 1]], atol=1e-12)


PLY = """ply
format ascii 1.0
comment made by hand
element vertex 5
property double x
property double y
property double z
property uchar red
element face 2
property list uchar int vertex_indices
property uchar flags
end_header
0 0 0 9
1 0 0 9
1 1 0 9
0 1 0 9
0 0 1 9
4 0 1 2 3 7
3 0 1 4 7
"""


def binary_ply(order):
    name = {"<": "little", ">": "big"}[order]
    head = PLY.partition("end_header\n")[0].replace("ascii", f"binary_{name}_endian")
    rows = [
        struct.pack(f"{order}dddB", *map(float, line.split()[:3]), 9)
        for line in PLY.splitlines()[12:17]
    ]
    faces = struct.pack(f"{order}B4iB", 4, 0, 1, 2, 3, 7) + struct.pack(
        f"{order}B3iB", 3, 0, 1, 4, 7
    )
    return head.encode() + b"end_header\n" + b"".join(rows) + faces


@pytest.mark.parametrize(
    "content",
    [PLY.encode(), PLY.replace("\n", "\r\n").encode(), binary_ply("<"), binary_ply(">")],
    ids=["ascii", "crlf", "little", "big"],
)
def test_a_ply_of_any_kind_has_its_polygons(read, content):
    mesh = read("a.ply", content)
    assert len(mesh.faces) == 3
    assert mesh.area == pytest.approx(1.5)


def test_strips_of_a_ply_are_read(read):
    text = PLY.partition("element face")[0] + (
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
        "0 0 0 9\n1 0 0 9\n0 1 0 9\n1 1 0 9\n0 0 1 9\n8 0 1 2 3 -1 0 1 4\n"
    )
    assert read("a.ply", text).area == pytest.approx(1.5)


def test_an_obj_may_count_backwards_go_on_in_the_next_line_and_have_colours(read):
    text = (
        "# two objects\no a\nv 0 0 0 1 0 0\nv 1 0 0 1 0 0 # red\nv 0 1 \\\n 0\nvn 0 0 1\n"
        "f -3//1 -2//1 -1//1\no b\nv 0 0 5\nv 1 0 5\nv 1 1 5\nv 0 1 5\nl 1 2\n"
        "f -4 -3 -2 -1\nf 1/1/1 2/1/1 3/1/1\n"
    )
    for content in (text, text.replace("\n", "\r\n")):
        mesh = read("a.obj", content)
        assert len(mesh.faces) == 4
        np.testing.assert_allclose(mesh.triangles[0], [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
        np.testing.assert_allclose(mesh.triangles[1:3, :, 2], 5.0)
        assert mesh.area == pytest.approx(2.0)


@pytest.mark.parametrize("suffix", [".obj", ".stl", ".off", ".ply", ".dae", ".gltf"])
def test_a_text_may_begin_with_a_byte_order_mark(read, suffix):
    content = b"\xef\xbb\xbf" + every_format()[suffix][-1]
    assert read(f"a{suffix}", content).volume == pytest.approx(4.0)


def test_a_binary_stl_may_begin_with_solid_and_end_with_more(read):
    content = exported("stl")
    renamed = b"solid rock" + content[10:]
    for content in (renamed, renamed + b"made by a tool"):
        np.testing.assert_allclose(read("a.stl", content).extents, SIZE)


def test_an_off_may_have_colours_comments_and_its_counts_in_the_first_line(read):
    text = "COFF 4 2 0 # counts\n\n0 0 0 255 0 0 1\n1 0 0 1 1 1 1\n1 1 0 1 1 1 1\n0 1 0 1 1 1 1\n"
    assert read("a.off", text + "3 0 1 2 0.5 0.5 0.5\n3 0 2 3\n").area == pytest.approx(1.0)


@pytest.mark.parametrize("suffix", every_format())
def test_a_file_that_is_cut_short_is_never_half_a_mesh(read, suffix):
    for content in every_format()[suffix]:
        for fraction in (0.0, 0.3, 0.6, 0.8, 0.9, 0.97):
            try:
                mesh = read(f"a{suffix}", content[: int(fraction * len(content))])
            except FileError:
                continue
            # a text that ends between two lines of faces cannot be told from a whole one
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


def test_what_trimesh_exports_is_read_in_metres(read):
    pytest.importorskip("lxml")
    pytest.importorskip("collada")
    # trimesh writes 3MF in millimetres whatever the mesh is in, and COLLADA with y up
    np.testing.assert_allclose(read("a.3mf", exported("3mf")).extents, SIZE / 1000, atol=1e-9)
    np.testing.assert_allclose(read("a.dae", exported("dae")).extents, [2, 4, 3], atol=1e-6)


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
