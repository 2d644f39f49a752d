"""PLY files of surface estimates: every bit comes back, in every form that the format allows."""

import numpy as np
import pytest
from plain.scanned_maps import FIELD_GRID, PLANAR_GRID, scanned_map

from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.mapping.files import (
    MapFileError,
    SurfaceEstimates,
    load_surfaces,
    save_map,
    save_surfaces,
)
from coopmap_env.mapping.files.ply import VERTEX_DTYPE

GRIDS = [pytest.param(PLANAR_GRID, id="2-D"), pytest.param(FIELD_GRID, id="3-D")]


@pytest.mark.parametrize("ascii_", [False, True])
@pytest.mark.parametrize("grid", GRIDS)
def test_a_ply_file_keeps_every_bit_of_the_surfaces(tmp_path, grid, ascii_):
    map_ = scanned_map(grid)
    save_surfaces(map_, tmp_path / "map.ply", ascii_)
    back, here = load_surfaces(tmp_path / "map.ply"), SurfaceEstimates.from_map(map_)
    assert len(here.cells) > 5
    np.testing.assert_array_equal(back.cells, here.cells)
    np.testing.assert_array_equal(back.means, here.means)
    np.testing.assert_array_equal(back.probability, here.probability)
    symmetric = 0.5 * (here.covariances + here.covariances.transpose(0, 2, 1))
    np.testing.assert_array_equal(back.covariances, symmetric)


@pytest.mark.parametrize("ascii_", [False, True])
def test_trimesh_reads_points_and_covariances_of_a_ply_file(tmp_path, ascii_):
    trimesh = pytest.importorskip("trimesh")
    map_ = scanned_map(VoxelGrid((9, 7, 8), 0.25, (0.55, -1.0, 2.0)))
    save_surfaces(map_, tmp_path / "map.ply", ascii_)
    cloud = trimesh.load(tmp_path / "map.ply")
    surfaces = SurfaceEstimates.from_map(map_)
    np.testing.assert_allclose(cloud.vertices, surfaces.means)
    data = cloud.metadata["_ply_raw"]["vertex"]["data"]
    column = data["covariance_xz"] if not ascii_ else np.asarray(data["covariance_xz"])
    np.testing.assert_allclose(np.ravel(column), surfaces.covariances[:, 0, 2], atol=1e-12)


def test_a_map_without_surfaces_is_a_ply_file_without_vertices(tmp_path):
    save_map(OccupancyMap(VoxelGrid((4, 5))), tmp_path / "map.ply")
    assert load_surfaces(tmp_path / "map.ply").means.shape == (0, 2)


def test_a_ply_file_that_lacks_a_vertex_or_a_property_is_rejected(tmp_path):
    path = tmp_path / "map.ply"
    for ascii_ in (False, True):
        save_surfaces(scanned_map(VoxelGrid((14, 11))), path, ascii_)
        content = path.read_bytes()
        path.write_bytes(content[:-3] if not ascii_ else content.rsplit(b"\n", 2)[0])
        with pytest.raises(MapFileError, match="truncated"):
            load_surfaces(path)
        path.write_bytes(content.replace(b"covariance_xy", b"covariance_no"))
        with pytest.raises(MapFileError, match=r"lacks .*covariance_xy"):
            load_surfaces(path)


def ply_forms(content, ascii_):
    """The same file as other programs write it."""
    head, body = content.split(b"end_header\n")
    for line_end in (b"\r\n", b"\r"):
        new_body = body.replace(b"\n", line_end) if ascii_ else body
        yield (head + b"end_header\n").replace(b"\n", line_end) + new_body
    yield content.replace(b"comment surface", b"obj_info by hand\ncomment end_header surface")
    yield content.replace(b"end_header\n", b"element face 0 \nend_header \n")
    if ascii_:
        yield content.replace(b"end_header\n", b"end_header\n \n") + b"\n3 0 1 2\n"
    else:
        rows = np.frombuffer(body, VERTEX_DTYPE)
        big = head.replace(b"little", b"big") + b"end_header\n"
        yield big + rows.astype(VERTEX_DTYPE.newbyteorder(">")).tobytes()


@pytest.mark.parametrize("ascii_", [False, True])
def test_line_ends_orders_of_bytes_and_further_elements_change_no_bit(tmp_path, ascii_):
    map_ = scanned_map(VoxelGrid((14, 11), 0.5, (-2.0, 1.0)))
    save_surfaces(map_, tmp_path / "map.ply", ascii_)
    here = load_surfaces(tmp_path / "map.ply")
    for content in ply_forms((tmp_path / "map.ply").read_bytes(), ascii_):
        (tmp_path / "other.ply").write_bytes(content)
        back = load_surfaces(tmp_path / "other.ply")
        for name in ("cells", "means", "covariances", "probability"):
            np.testing.assert_array_equal(getattr(back, name), getattr(here, name))


def test_vertices_of_4_byte_floats_are_read_and_their_nans_are_found(tmp_path):
    save_surfaces(scanned_map(PLANAR_GRID), tmp_path / "map.ply")
    head, body = (tmp_path / "map.ply").read_bytes().split(b"end_header\n")
    types = [(name, "<i4" if name == "cell" else "<f4") for name in VERTEX_DTYPE.names]
    rows = np.frombuffer(body, VERTEX_DTYPE).astype(types)
    narrow = head.replace(b"double", b"float") + b"end_header\n"
    (tmp_path / "narrow.ply").write_bytes(narrow + rows.tobytes())
    here, back = load_surfaces(tmp_path / "map.ply"), load_surfaces(tmp_path / "narrow.ply")
    np.testing.assert_array_equal(back.means, here.means.astype(np.float32))
    signalling_nan = b"\1\0\x80\x7f"
    (tmp_path / "nan.ply").write_bytes(narrow + signalling_nan + rows.tobytes()[4:])
    with pytest.raises(MapFileError, match=r"nan\.ply: its points and covariances must be finite"):
        load_surfaces(tmp_path / "nan.ply")


def broken_ply(content):
    vertices = content.split(b"element vertex ")[1].split(b"\n")[0]
    yield "99,999,999,999 cells, more than the limit", replace_count(content, vertices, b"9" * 11)
    yield "truncated: ", replace_count(content, vertices, b"9" * 5)
    yield "cannot read 'element vertex -1'", replace_count(content, vertices, b"-1")
    yield "cannot read 'element vertex 9999", replace_count(content, vertices, b"9" * 5000)
    yield "no PLY file", content[1:]
    yield "no end_header", content.replace(b"end_header", b"end header")
    yield "expected a PLY format", content.replace(b"format ascii 1.0\n", b"")
    yield (
        "must be finite",
        content.replace(b"end_header\n", b"end_header\nnan" + b" 1" * 10 + b"\n"),
    )
    yield "lie in", content.replace(b"end_header\n", b"end_header\n" + b"2 " * 11 + b"\n")
    yield "at least 0", content.replace(b"end_header\n", b"end_header\n" + b"1 " * 10 + b"-1\n")
    yield "integer", content.replace(b"property int cell", b"property double cell")
    yield (
        "the same name",
        content.replace(b"property int cell", b"property int x\nproperty int cell"),
    )


def replace_count(content, vertices, number):
    return content.replace(b"element vertex " + vertices, b"element vertex " + number)


def test_a_broken_ply_file_is_rejected_with_its_name_and_what_is_wrong(tmp_path):
    save_surfaces(scanned_map(VoxelGrid((14, 11))), tmp_path / "map.ply", ascii_=True)
    content = (tmp_path / "map.ply").read_bytes()
    for message, wrong in broken_ply(content):
        assert wrong != content
        (tmp_path / "wrong.ply").write_bytes(wrong)
        with pytest.raises(MapFileError, match=message) as error:
            load_surfaces(tmp_path / "wrong.ply")
        assert str(error.value).startswith(f"{tmp_path / 'wrong.ply'}: ")
