import numpy as np
import pytest

from coopmap_env.simulation.scenes import SceneError
from coopmap_env.simulation.scenes.field import FIELD_GRID, make_field_scene, read_user_scene
from coopmap_env.simulation.scenes.field._solid_queries import distance_to_axis

pytest.importorskip("yaml")

TARGET = "  - {box: [1, 0.6, 0.8], position: [0, 0, 0.4], rpy: [0, 0, 90], target: true}\n"
TETRAHEDRON = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
# an L, which is closed and not convex
CORNER = """
v 0 0 0\nv 2 0 0\nv 2 1 0\nv 1 1 0\nv 1 2 0\nv 0 2 0
v 0 0 1\nv 2 0 1\nv 2 1 1\nv 1 1 1\nv 1 2 1\nv 0 2 1
f 1 4 3\nf 1 3 2\nf 1 6 5\nf 1 5 4\nf 7 9 10\nf 7 8 9\nf 7 11 12\nf 7 10 11
f 1 2 8\nf 1 8 7\nf 2 3 9\nf 2 9 8\nf 3 4 10\nf 3 10 9\nf 4 5 11\nf 4 11 10\nf 5 6 12\nf 5 12 11
f 6 1 7\nf 6 7 12
"""
URDF = """<robot name="r"><link name="a"><visual><origin xyz="0 0 1"/><geometry>
<box size="1 1 2"/></geometry></visual></link>
<link name="b"><visual><geometry><mesh filename="{mesh}"/></geometry></visual></link>
<joint name="j" type="fixed"><parent link="a"/><child link="b"/><origin xyz="3 0 0"/></joint>
</robot>"""


@pytest.fixture
def write(tmp_path):
    (tmp_path / "tetrahedron.obj").write_text(TETRAHEDRON)
    (tmp_path / "corner.obj").write_text(CORNER)

    def write(text):
        path = tmp_path / "yard.yaml"
        path.write_text(text)
        return path

    return write


def drawn(path, n_robots=2, footprint=1.2):
    return make_field_scene(path).world(np.random.default_rng(0), n_robots, footprint)


def test_boxes_stand_where_the_file_puts_them(write):
    path = write(f"objects:\n{TARGET}  - {{box: [2, 1, 1], scale: 0.5, position: [2, 2, 0.25]}}\n")
    scene = read_user_scene(path)
    ground, target, box = scene.solids
    assert scene.name == "yard"
    assert scene.grid == FIELD_GRID
    assert ground.is_ground
    assert target.is_target
    assert not box.is_target
    np.testing.assert_allclose(target.bounds, [[-0.3, -0.5, 0], [0.3, 0.5, 0.8]], atol=1e-12)
    np.testing.assert_allclose(box.bounds, [[1.5, 1.75, 0], [2.5, 2.25, 0.5]])
    assert [solid.name for solid in scene.solids] == ["ground", "object_0", "object_1"]


def test_drawn_bases_keep_clear_and_named_ones_stand_as_named(write):
    path = write(f"objects:\n{TARGET}  - {{box: [2, 2, 2], position: [3, 0, 1]}}\n")
    world = drawn(path, 3)
    assert world.target == "object_0"
    assert world.occupied[64, 64, 6]
    for pose in world.base_poses:
        assert distance_to_axis(pose.translation, world.solids) >= 1.2
    path = write(f"objects:\n{TARGET}bases: [[3, 0, 180], [0, 3, -9e1]]\n")
    poses = drawn(path).base_poses
    np.testing.assert_allclose(poses[0].translation, [3, 0, 0])
    np.testing.assert_allclose(poses[0].rotation[:, 0], [-1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(poses[1].rotation[:, 0], [0, -1, 0], atol=1e-12)


def test_ground_and_grid_can_be_chosen(write):
    grid = "grid: {shape: [60, 60, 20], resolution: 0.2, origin: [-6, -6, -0.5]}\n"
    scene = read_user_scene(write(f"ground: false\n{grid}objects:\n{TARGET}"))
    assert scene.grid.shape == (60, 60, 20)
    assert scene.grid.resolution == 0.2
    assert not any(solid.is_ground for solid in scene.solids)


def test_meshes_are_scaled_rotated_and_recognised_as_convex_or_not(write):
    pytest.importorskip("trimesh")
    text = (
        "objects:\n  - {mesh: tetrahedron.obj, scale: [1, 2, 3], rpy: [0, 0, 90], target: true}\n"
        "  - {mesh: corner.obj, position: [3, 3, 0]}\n"
    )
    _, tetrahedron, corner = read_user_scene(write(text)).solids
    np.testing.assert_allclose(tetrahedron.bounds, [[-2, 0, 0], [0, 1, 3]], atol=1e-12)
    assert len(tetrahedron.hulls) == 1
    assert not tetrahedron.is_concave
    assert corner.is_concave
    assert not corner.hulls
    world = drawn(write(text), 1)
    inside, notch = world.grid.index([[3.5, 4.5, 0.5], [4.5, 4.5, 0.5]])
    assert world.occupied[tuple(inside)]
    assert not world.occupied[tuple(notch)]


def test_all_links_of_a_urdf_are_one_solid(write):
    pytest.importorskip("trimesh")
    path = write("objects:\n  - {urdf: r.urdf, name: rack, target: true}\n")
    (path.parent / "r.urdf").write_text(URDF.format(mesh="tetrahedron.obj"))
    _, rack = read_user_scene(path).solids
    assert rack.name == "rack"
    np.testing.assert_allclose(rack.bounds, [[-0.5, -0.5, 0], [4, 1, 2]])
    assert len(rack.hulls) == 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("objects: [", "expected YAML"),
        ("- 1", "expected a YAML mapping of fields"),
        ("robots: 2\nobjects: []", "unknown field 'robots', expected grid, ground, objects, bases"),
        ("ground: true", "objects is missing, expected a list"),
        ("objects: []", "objects must be a list of at least one object"),
        ("objects: [3]", r"objects\[0\]: expected a mapping of fields, not 3"),
        ("objects: [{box: [1, 1, 1]}]", "objects must hold a target"),
        (f"ground: 1\nobjects:\n{TARGET}", "ground must be true or false, not 1"),
        (f"objects:\n{TARGET}  - {{colour: red}}", r"objects\[1\]: unknown field 'colour'"),
        (f"objects:\n{TARGET}  - {{name: a}}", r"objects\[1\]: expected one of box.*not none"),
        (f"objects:\n{TARGET}  - {{box: [1, 1, 1], mesh: a.obj}}", r"not \['box', 'mesh'\]"),
        (f"objects:\n{TARGET}  - {{box: [1, 0, 1]}}", "box must be three finite numbers above 0"),
        ("objects: [{box: [1, 1, 1], position: [0, .nan, 0]}]", "position must be three finite"),
        ("objects: [{box: [1, 1, 1], rpy: 3}]", "rpy must be three finite numbers, not 3"),
        ("objects: [{box: [1, 1, 1], scale: 0}]", "scale must be a finite number above 0"),
        ("objects: [{box: [1, 1, 1], target: 1}]", "target must be true or false"),
        ("objects: [{box: [1, 1, 1], name: ground}]", "name must differ from all others"),
        (f"bases: 3\nobjects:\n{TARGET}", "bases must be a list"),
        (f"bases: [[0, 3]]\nobjects:\n{TARGET}", r"bases\[0\] must be three finite numbers"),
        (f"bases: [[0, 30, 0]]\nobjects:\n{TARGET}", "base 0 must stand in the grid"),
        (f"grid: 3\nobjects:\n{TARGET}", "grid must be a mapping"),
        (f"grid: {{shape: [2.5, 2, 2]}}\nobjects:\n{TARGET}", "three integers"),
        (f"grid: {{shape: [9, 9, 9]}}\nobjects:\n{TARGET}", "grid: origin is missing"),
        (f"grid: {{shape: [9, 9, 9], origin: [0, 0, 5]}}\nobjects:\n{TARGET}", "below the ground"),
        ("objects: [{box: [1, 1, 1], position: [50, 0, 0], target: true}]", "reach into the grid"),
        (
            "grid: {shape: [5000, 5000, 5000], origin: [0, 0, -1]}",
            "125,000,000,000 cells.*COOPMAP_",
        ),
        (
            "grid: {shape: [1e300, 9, 9], origin: [0, 0, -1]}",
            "shape must be three numbers of at most",
        ),
        ("grid: {shape: [9, 9, 9], resolution: 1e-300, origin: [0, 0, -1]}", "from 0.0001 to 1000"),
        ("objects: [{box: [1e308, 1, 1]}]", "box must be three numbers of at most 1e.06"),
        ("objects: [{box: [1e-300, 1e-300, 1e-300]}]", "it is 1e-300 m large.*unit or scale"),
        ("objects: [{box: [1, 1, 1], scale: 1e200}]", "scale must be a number of at most 1e.06"),
        (
            'objects: [{box: [1, 1, 1], name: "a\\nb"}]',
            "name must be text of at most 100 printable",
        ),
        (f"objects: [{{box: [1, 1, 1], name: {'x' * 300}}}]", "name must be text of at most 100"),
        (f"objects: [{{mesh: {'x' * 5000}.stl}}]", "mesh must be text of at most 1000"),
        ("objects: [{mesh: http://example.org/a.stl}]", "file:// or package://"),
        ("objects: [{mesh: package://nowhere/a.stl}]", "package_dirs"),
        ("objects: [{mesh: 3}]", "mesh must be text"),
        ("objects: [{mesh: [a.stl]}]", "mesh must be text"),
        ("objects: [" + "~, " * 10_001 + "]", "a list of at most 10,000 objects"),
        (f"objects: &a\n{TARGET}bases: *a", "line 3: the alias"),
        (f"ground: true\nground: false\nobjects:\n{TARGET}", "line 2: 'ground' is there twice"),
        ("objects: [{box: [1, 1, 1], position: 2020-01-01}]", "position must be three finite"),
        ("objects: [{box: {x: 1}}]", "box must be three finite numbers above 0, not {'x': 1}"),
    ],
)
def test_a_broken_file_says_where_and_what_was_expected(write, text, message):
    path = write(text)
    with pytest.raises(SceneError, match=message) as caught:
        read_user_scene(path)
    assert str(caught.value).startswith(str(path))
    assert len(str(caught.value)) < len(str(path)) + 600


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("none.obj", None, "no such file"),
        ("empty.obj", "", "no triangles"),
        ("points.obj", "v 0 0 0\nv 1 0 0\n", "no triangles"),
        ("line.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no surface with an area"),
        ("broken.stl", "solid nothing", "cut short"),
        ("nan.obj", TETRAHEDRON.replace("v 1 0 0", "v nan 0 0"), "not nan"),
        ("a.xyzabc", "1", "a mesh must be a file ending in .stl"),
    ],
)
def test_a_broken_mesh_says_which_entry_and_why(write, file, content, message):
    pytest.importorskip("trimesh")
    path = write(f"objects:\n{TARGET}  - {{mesh: {file}}}\n")
    if content is not None:
        (path.parent / file).write_text(content)
    with pytest.raises(SceneError, match=message) as caught:
        read_user_scene(path)
    assert "objects[1]" in str(caught.value)
    assert file in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("<robot", "line 1, column 0: expected XML"),
        ("<robot name='r'><link name='a'/></robot>", "none of its links has a shape"),
        (URDF.format(mesh="missing.obj"), "missing.obj.*package_dirs"),
    ],
)
def test_a_broken_urdf_says_which_entry_and_why(write, content, message):
    pytest.importorskip("trimesh")
    path = write("objects:\n  - {urdf: r.urdf, target: true}\n")
    (path.parent / "r.urdf").write_text(content)
    with pytest.raises(SceneError, match=message) as caught:
        read_user_scene(path)
    assert "objects[0]" in str(caught.value)


def test_bases_that_do_not_fit_say_so(write):
    path = write(f"objects:\n{TARGET}bases: [[3, 0, 180], [1, 0, 180], [3.5, 0, 0]]\n")
    with pytest.raises(ValueError, match="names 3 bases, too few for 4 robots"):
        drawn(path, 4)
    with pytest.raises(ValueError, match=r"base 1 of yard must keep 1.2 m clear.*not 0.70 m"):
        drawn(path, 2)
    with pytest.raises(ValueError, match=r"bases 0 and 2 of yard must stand 0.6 m apart, not 0.50"):
        drawn(path, 3, 0.6)
    assert drawn(path, 2, 0.6).n_robots == 2


def test_a_file_that_is_not_there_says_so(tmp_path):
    with pytest.raises(SceneError, match=r"nowhere.yml: there is no such file"):
        make_field_scene(tmp_path / "nowhere.yml")
