"""Meshes and URDFs of user scenes: their units, odd but legal ones, and what is refused."""

import numpy as np
import pytest

pytest.importorskip("yaml")
pytest.importorskip("trimesh")

import trimesh
from plain.meshes import dae, exported, threemf

from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.field import read_user_scene

BOX = '<visual><geometry><box size="{}"/></geometry></visual>'
MESH = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
TETRAHEDRON = (
    "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"  # faces outwards
)
WALL = "v 0 0 0\nv 2 0 0\nv 2 0 2\nv 0 0 2\nf 1 2 3 4\n"


def robot(*shapes):
    return f"<robot name='r'><link name='a'>{''.join(shapes)}</link></robot>"


@pytest.fixture
def solid(tmp_path):
    """Write a file and read the solid that it is in a scene."""

    def solid(name, content, fields="", top=""):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content.encode() if isinstance(content, str) else content)
        kind = "urdf" if name.endswith("urdf") else "mesh"
        scene = tmp_path / "yard.yaml"
        scene.write_text(f"{top}\nobjects: [{{{kind}: {name}, target: true{fields}}}]\n")
        return read_user_scene(scene).solids[1]

    return solid


def occupied(solid, points):
    """Whether the voxels at points are occupied in the world of one solid."""
    from coopmap_env.simulation.scenes.field import FIELD_GRID
    from coopmap_env.simulation.scenes.field._voxel_truth import voxelize_solids

    return [
        bool(voxelize_solids([solid], FIELD_GRID)[tuple(FIELD_GRID.index([point])[0])])
        for point in points
    ]


@pytest.mark.parametrize(
    ("name", "content", "size"),
    [
        ("a.dae", dae('<unit meter="0.001"/><up_axis>Z_UP</up_axis>'), [0.002, 0.003, 0.004]),
        ("a.dae", dae('<unit meter="0.0254"/><up_axis>Y_UP</up_axis>'), [0.0508, 0.1016, 0.0762]),
        ("a.glb", exported("glb"), [2, 4, 3]),
        ("a.3mf", threemf(""), [0.002, 0.003, 0.004]),
        ("a.stl", exported("stl"), [2, 3, 4]),
    ],
)
def test_a_mesh_has_its_size_in_metres(solid, name, content, size):
    found = solid(name, content, ", scale: 10")
    np.testing.assert_allclose(np.ptp(found.bounds, axis=0), np.multiply(size, 10), rtol=1e-6)
    assert len(found.hulls) == 1


def test_the_meshes_of_a_urdf_have_theirs_and_its_coordinates_as_robots_use_them(solid, tmp_path):
    asset = '<unit meter="0.001"/><up_axis>Y_UP</up_axis>'
    (tmp_path / "a.dae").write_bytes(dae(asset))
    found = solid("r.urdf", robot(MESH.format("a.dae")))
    np.testing.assert_allclose(found.bounds, [[0, 0, 0], [0.002, 0.003, 0.004]], atol=1e-12)


def test_a_mirrored_and_an_inverted_mesh_are_still_convex_and_filled(solid, tmp_path):
    inverted = TETRAHEDRON[: TETRAHEDRON.index("f")] + "f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n"
    (tmp_path / "a.obj").write_text(TETRAHEDRON)
    mirrored = robot(
        '<visual><geometry><mesh filename="a.obj" scale="-1 1 1"/></geometry></visual>'
    )
    for found in (solid("b.obj", inverted, ", scale: 2"), solid("r.urdf", mirrored, ", scale: 2")):
        assert len(found.hulls) == 1
        sign = np.sign(found.bounds.mean(axis=0)[0])
        assert occupied(found, [[0.4 * sign, 0.4, 0.4], [1.5 * sign, 1.5, 1.5]]) == [True, False]


def test_shapes_without_area_are_ignored(solid):
    with_nothing = TETRAHEDRON + "v 5 5 5\nv 6 5 5\nv 7 5 5\nf 5 6 7\nf 5 5 6\nf 6 6 6\n"
    found = solid("a.obj", with_nothing)
    np.testing.assert_allclose(found.bounds, [[0, 0, 0], [1, 1, 1]])
    assert len(found.hulls) == 1
    shapes = [BOX.format(size) for size in ("0 0 0", "1 0 0", "1 1 1")]
    found = solid("r.urdf", robot(*shapes))
    np.testing.assert_allclose(found.bounds, [[-0.5] * 3, [0.5] * 3])
    assert len(found.hulls) == 1
    assert np.isfinite(found.triangles).all()


@pytest.mark.parametrize(
    "shape",
    [
        BOX.format("0 0 0"),
        BOX.format("1 0 0"),
        '<visual><geometry><sphere radius="0"/></geometry></visual>',
        '<visual><geometry><cylinder radius="0" length="1"/></geometry></visual>',
    ],
)
def test_a_urdf_of_nothing_but_shapes_without_area_is_refused(solid, shape):
    with pytest.raises(SceneError, match=r"objects\[0\]: urdf: .*r\.urdf"):
        solid("r.urdf", robot(shape))


@pytest.mark.filterwarnings("ignore:.*open")
def test_a_box_without_thickness_is_a_wall(solid):
    found = solid("r.urdf", robot(BOX.format("2 0 2")), ", position: [0.55, 0.55, 1]")
    assert found.is_concave
    np.testing.assert_allclose(found.bounds, [[-0.45, 0.55, 0], [1.55, 0.55, 2]])
    points = [[0.55, 0.55, 1], [0.55, 0.75, 1], [0.55, 0.35, 1]]
    assert occupied(found, points) == [True, False, False]


def test_a_wall_of_no_thickness_is_a_concave_solid_with_one_warning(solid):
    with pytest.warns(UserWarning, match=r"wall\.obj: the surface is open") as caught:
        found = solid("wall.obj", WALL, ", position: [0, 0.55, 0]")
    assert len(caught) == 1
    assert found.is_concave
    assert occupied(found, [[1, 0.55, 1], [1, 0.75, 1]]) == [True, False]


def test_an_open_mesh_gives_one_warning_and_has_no_inside(solid):
    box = trimesh.creation.box((2, 2, 2))
    box.update_faces(np.arange(12) != 3)
    with pytest.warns(UserWarning, match=r"b\.stl: the surface is open") as caught:
        found = solid("b.stl", box.export(file_type="stl"))
    assert len(caught) == 1
    assert found.is_concave
    assert occupied(found, [[0.05, 0.05, 0.05], [1, 0, 0]]) == [False, True]


def test_a_double_sided_mesh_is_the_same_as_a_single_sided_one(solid):
    turned = "f 1 2 3\nf 1 4 2\nf 1 3 4\nf 2 4 3\n"
    single = solid("a.obj", TETRAHEDRON, ", scale: 2")
    for text in (TETRAHEDRON + turned, TETRAHEDRON + TETRAHEDRON.replace("f", "f")):
        double = solid("b.obj", text, ", scale: 2")
        assert len(double.hulls) == 1
        assert occupied(double, [[0.4, 0.4, 0.4]]) == occupied(single, [[0.4, 0.4, 0.4]]) == [True]


def test_two_boxes_that_share_a_face_are_still_filled(solid):
    left, right = trimesh.creation.box((1, 1, 1)), trimesh.creation.box((1, 1, 1))
    right.apply_transform(np.diag([-1, 1, 1, 1]))
    right.apply_translation([1, 0, 0])
    both = trimesh.util.concatenate([left, right])
    found = solid("b.stl", both.export(file_type="stl"))
    assert occupied(found, [[0.05, 0.05, 0.05], [0.95, 0.05, 0.05], [1.8, 0, 0]]) == [
        True, True, False,
    ]  # fmt: skip


def test_capsules_of_a_urdf_are_solids(solid):
    capsule = '<visual><geometry><capsule radius="0.5" length="1"/></geometry></visual>'
    found = solid("r.urdf", robot(capsule))
    np.testing.assert_allclose(found.bounds, [[-0.5, -0.5, -1], [0.5, 0.5, 1]], atol=0.02)
    assert len(found.hulls) == 1


def test_a_mimic_joint_of_a_urdf_stands_at_its_offset(solid):
    text = (
        "<robot name='r'><link name='a'/><link name='b'>" + BOX.format("1 1 1") + "</link>"
        "<link name='c'/><joint name='j' type='prismatic'><parent link='a'/><child link='b'/>"
        "<axis xyz='0 0 1'/><limit lower='0' upper='9' effort='1' velocity='1'/>"
        "<mimic joint='k' offset='2'/></joint>"
        "<joint name='k' type='prismatic'><parent link='a'/><child link='c'/>"
        "<axis xyz='0 0 1'/><limit lower='0' upper='9' effort='1' velocity='1'/></joint></robot>"
    )
    np.testing.assert_allclose(solid("r.urdf", text).bounds[:, 2], [1.5, 2.5])


def test_packages_of_a_urdf_are_found_in_the_usual_layout_and_in_package_dirs(solid, tmp_path):
    urdf = robot(MESH.format("package://shelf_description/meshes/a.obj"))
    package = tmp_path / "ws" / "src" / "shelf_description"
    for folder in ("meshes", "urdf"):
        (package / folder).mkdir(parents=True)
    (package / "package.xml").write_text("<package><name>shelf_description</name></package>")
    (package / "meshes" / "a.obj").write_text(TETRAHEDRON)
    found = solid("ws/src/shelf_description/urdf/shelf.urdf", urdf)
    np.testing.assert_allclose(found.bounds, [[0, 0, 0], [1, 1, 1]])
    found = solid("elsewhere/shelf.urdf", urdf, top="package_dirs: [ws/src]")
    np.testing.assert_allclose(found.bounds, [[0, 0, 0], [1, 1, 1]])
    (tmp_path / "r.yaml").write_text(
        "package_dirs: [ws/src]\n"
        "objects: [{urdf: package://shelf_description/urdf/shelf.urdf, target: true},"
        " {mesh: package://shelf_description/meshes/a.obj}]"
    )
    for found in read_user_scene(tmp_path / "r.yaml").solids[1:]:
        np.testing.assert_allclose(found.bounds, [[0, 0, 0], [1, 1, 1]])
    with pytest.raises(SceneError, match=r"objects\[0\]: urdf: .*shelf_description/meshes/a\.obj"):
        solid("elsewhere/shelf.urdf", urdf)


@pytest.mark.parametrize("value", ["3", "[3]", "[nowhere]", '["a\\0b"]', "{a: b}", "a"])
def test_package_dirs_must_be_folders(solid, value):
    with pytest.raises(SceneError, match=r"yard\.yaml.*package_dirs"):
        solid("a.obj", TETRAHEDRON, top=f"package_dirs: {value}")


def test_a_mesh_that_is_too_large_for_the_physics_is_refused(solid, monkeypatch):
    shape_files = "coopmap_env.simulation.scenes.field._shape_files"
    convex = trimesh.creation.icosphere(subdivisions=2).export(file_type="stl")
    concave = trimesh.creation.torus(1, 0.3).export(file_type="stl")
    monkeypatch.setattr(f"{shape_files}.MAX_FACES", 1000)
    assert len(solid("a.stl", convex).hulls) == 1
    with pytest.raises(SceneError, match=r"a\.stl has 2,048 triangles.*1,000.*simplify"):
        solid("a.stl", concave)
    monkeypatch.setattr(f"{shape_files}.MAX_VERTICES", 161)
    with pytest.raises(SceneError, match=r"a\.stl has 162 vertices.*simplify"):
        solid("a.stl", convex)


def test_a_mesh_that_a_scene_names_often_is_read_once_and_its_triangles_are_limited(
    solid, tmp_path, monkeypatch
):
    (tmp_path / "wall.obj").write_text(WALL)
    entries = ", ".join(["{mesh: wall.obj, target: true}"] * 5)
    (tmp_path / "s.yaml").write_text(f"objects: [{entries}]")
    with pytest.warns(UserWarning, match="open") as caught:
        assert len(read_user_scene(tmp_path / "s.yaml").solids) == 6
    assert len(caught) == 1
    monkeypatch.setattr("coopmap_env.simulation.scenes.field.user_file.MAX_FACES", 5)
    with (
        pytest.warns(UserWarning, match="open"),
        pytest.raises(SceneError, match=r"objects\[2\]: with it .* 5 triangles"),
    ):
        read_user_scene(tmp_path / "s.yaml")
