"""Meshes of every format but COLLADA: their units, axes, nodes and primitives."""

import json
import struct

import numpy as np
import pytest

pytest.importorskip("trimesh")

from plain.meshes import FACES, PLY, SIZE, VERTICES, every_format, exported, gltf, threemf

from coopmap_env.core.files import FileError

TURNED = VERTICES @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]  # y of the file is up


@pytest.mark.parametrize("suffix", every_format())
def test_every_format_gives_the_same_triangles(read, suffix):
    expected = TURNED if suffix in (".gltf", ".glb") else VERTICES
    for content in every_format()[suffix]:
        mesh = read(f"a{suffix.upper()}", content)
        np.testing.assert_allclose(mesh.triangles, expected[FACES], atol=1e-6)
        assert mesh.volume == pytest.approx(4.0)


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


def test_a_comment_of_a_ply_may_name_the_end_of_the_header(read):
    content = PLY.replace("made by hand", "its end_header\ncomment is below")
    assert read("a.ply", content).area == pytest.approx(1.5)


def test_a_binary_ply_may_begin_with_the_byte_of_a_line_end(read):
    head, _, body = binary_ply("<").partition(b"end_header\n")
    head = head.replace(b"property double x", b"property uchar tag\nproperty double x")
    rows = b"".join(b"\n" + body[25 * k : 25 * (k + 1)] for k in range(5)) + body[125:]
    content = head.replace(b"\n", b"\r") + b"end_header\r" + rows
    assert read("a.ply", content).area == pytest.approx(1.5)


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


def test_what_trimesh_exports_is_read_in_metres(read):
    pytest.importorskip("lxml")
    pytest.importorskip("collada")
    # trimesh writes 3MF in millimetres whatever the mesh is in, and COLLADA with y up
    np.testing.assert_allclose(read("a.3mf", exported("3mf")).extents, SIZE / 1000, atol=1e-9)
    np.testing.assert_allclose(read("a.dae", exported("dae")).extents, [2, 4, 3], atol=1e-6)
