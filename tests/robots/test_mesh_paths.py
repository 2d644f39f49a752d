"""Meshes of URDFs: where they are searched, and that PyBullet collides with what we read."""

import struct

import numpy as np
import pytest

from coopmap_env.geometry import Pose
from coopmap_env.robots import Chain, Mount, UrdfError, mount_from_urdf, resolve_mesh

TRIANGLES = np.array([
    [[0, 0, 0], [1, 0, 0], [0, 2, 0]], [[0, 0, 0], [1, 0, 0], [0, 0, 3]],
    [[0, 0, 0], [0, 2, 0], [0, 0, 3]], [[1, 0, 0], [0, 2, 0], [0, 0, 3]],
])  # fmt: skip


def text_stl(triangles):
    facets = (
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in triangle)
        + "endloop\nendfacet\n"
        for triangle in triangles.tolist()
    )
    return ("solid a\n" + "".join(facets) + "endsolid a\n").encode()


def binary_stl(triangles):
    rows = (struct.pack("<12fH", 0, 0, 0, *triangle.ravel(), 0) for triangle in triangles)
    return bytes(80) + struct.pack("<I", len(triangles)) + b"".join(rows)


def off(triangles):
    points = "".join(f"{x} {y} {z}\n" for x, y, z in triangles.reshape(-1, 3).tolist())
    faces = "".join(f"3 {3 * i} {3 * i + 1} {3 * i + 2}\n" for i in range(len(triangles)))
    return f"OFF\n{3 * len(triangles)} {len(triangles)} 0\n{points}{faces}".encode()


def arm(mesh):
    shape = f'<geometry><mesh filename="{mesh}"/></geometry>'
    return (
        '<robot name="arm"><link name="stand"><inertial><mass value="100"/><inertia ixx="9" '
        'ixy="0" ixz="0" iyy="9" iyz="0" izz="9"/></inertial></link><joint name="tilt" '
        'type="revolute"><parent link="stand"/><child link="eye"/><axis xyz="0 1 0"/>'
        '<limit lower="-1" upper="1" effort="100" velocity="1"/></joint>'
        f'<link name="eye"><visual>{shape}</visual><collision>{shape}</collision></link></robot>'
    )


def touch(path):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(binary_stl(TRIANGLES))
    return path


@pytest.mark.parametrize(
    ("mesh", "package_xml"),
    [
        ("ws/src/shelf/meshes/a.stl", None),  # a folder of the package's name above the URDF
        ("ws/src/shelf_description/meshes/a.stl", "ws/src/shelf_description/package.xml"),
    ],
)
def test_a_package_is_searched_above_the_urdf(tmp_path, mesh, package_xml):
    expected = touch(tmp_path / mesh)
    package = expected.parents[1]
    if package_xml is not None:
        (tmp_path / package_xml).write_text(
            '<?xml version="1.0"?><package format="3"><name> shelf </name></package>'
        )
    urdf = package / "urdf" / "deep" / "shelf.urdf"
    found = resolve_mesh("package://shelf/meshes/a.stl", urdf)
    assert found.resolve() == expected.resolve()
    with pytest.raises(FileNotFoundError, match=r"shelf.urdf names the mesh package://desk/.*pack"):
        resolve_mesh("package://desk/meshes/a.stl", urdf)


def test_a_package_beside_that_of_the_urdf_is_found(tmp_path):
    expected = touch(tmp_path / "ws/src/meshes_of_all/a.stl")
    urdf = tmp_path / "ws/src/robot/urdf/robot.urdf"
    assert resolve_mesh("package://meshes_of_all/a.stl", urdf) == expected


def test_package_dirs_hold_packages_or_are_packages(tmp_path):
    expected = touch(tmp_path / "share/shelf/meshes/a.stl")
    urdf = tmp_path / "elsewhere" / "shelf.urdf"
    for folder in ("share", "share/shelf", "share/shelf/meshes"):
        found = resolve_mesh("package://shelf/meshes/a.stl", urdf, [tmp_path / folder])
        assert found.resolve() == expected.resolve()


def test_a_broken_package_xml_hides_nothing(tmp_path):
    expected = touch(tmp_path / "shelf/meshes/a.stl")
    (tmp_path / "shelf/package.xml").write_text("<package")
    assert resolve_mesh("package://shelf/meshes/a.stl", tmp_path / "shelf/urdf/a.urdf") == expected


def test_paths_are_relative_absolute_or_addresses_of_files(tmp_path):
    expected = touch(tmp_path / "meshes/a.stl")
    urdf = tmp_path / "a.urdf"
    for name in ("meshes/a.stl", str(expected), f"file://{expected}"):
        assert resolve_mesh(name, urdf) == expected
    with pytest.raises(UrdfError, match=r"a.urdf names the mesh 'http://x/a.stl': expected a path"):
        resolve_mesh("http://x/a.stl", urdf)
    with pytest.raises(FileNotFoundError, match="which is in none of"):
        resolve_mesh("n" * 5000, urdf)


@pytest.mark.parametrize(
    ("name", "content"),
    [("a.stl", binary_stl), ("a.stl", text_stl), ("A.STL", text_stl), ("a.off", off)],
)
@pytest.mark.parametrize("wrapped", [True, False])
def test_the_physics_engine_collides_with_the_mesh_that_we_read(tmp_path, name, content, wrapped):
    """PyBullet itself takes a text STL for nothing, and does not know most formats."""
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import BulletWorld

    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / name).write_bytes(content(TRIANGLES))
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm(f"package://arm/meshes/{name}"))
    if wrapped:
        mount = mount_from_urdf(urdf, ["tilt"], "eye", [0.0])
    else:
        mount = Mount("arm", urdf, "eye", ("tilt",), (0.0,))
    chain = mount.chain()
    np.testing.assert_allclose(chain.meshes[chain.link_names.index("eye")], TRIANGLES, atol=1e-7)
    world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
    vehicle = world.vehicles[0]
    link = vehicle.joint_map.link_names.index("eye") - 1
    box = world.client.p.getAABB(vehicle.number, link, physicsClientId=world.client.id)
    np.testing.assert_allclose(box, [[0, 0, 0], [1, 2, 3]], atol=0.01)
    world.close()


def test_a_urdf_that_changes_is_loaded_again_by_the_physics_engine(tmp_path):
    """PyBullet would keep the first one of the name."""
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import BulletWorld

    urdf = tmp_path / "arm.urdf"
    for height in (1.0, 2.0):
        box = f'<geometry><box size="0.2 0.2 {height}"/></geometry>'
        mesh = '<geometry><mesh filename="x"/></geometry>'
        urdf.write_text(arm("x").replace(mesh, box))
        mount = Mount("arm", urdf, "eye", ("tilt",), (0.0,))
        world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
        low, high = world.client.p.getAABB(
            world.vehicles[0].number, 0, physicsClientId=world.client.id
        )
        assert high[2] - low[2] == pytest.approx(height, abs=0.02)
        world.close()


def test_numbers_of_a_urdf_in_one_long_line_reach_the_physics_engine_whole(tmp_path):
    """PyBullet breaks lines every 8 kB, wherever that is."""
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import BulletWorld

    joints = "".join(
        f'<link name="l{i}"/><joint name="j{i}" type="fixed"><parent link="eye"/>'
        f'<child link="l{i}"/><origin xyz="0.123456789012 0.23456789012 {i}.345678901234"/></joint>'
        for i in range(90)
    )
    mesh = '<geometry><mesh filename="x"/></geometry>'
    text = arm("x").replace(mesh, '<geometry><box size="1 1 1"/></geometry>')
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(text.replace("</robot>", joints + "</robot>"))
    mount = Mount("arm", urdf, "eye", ("tilt",), (0.0,))
    world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
    vehicle, chain = world.vehicles[0], mount.chain()
    _, t = chain.link_poses([0.0])
    for j, name in enumerate(vehicle.joint_map.link_names[1:]):
        state = world.client.p.getLinkState(
            vehicle.number, j, computeForwardKinematics=1, physicsClientId=world.client.id
        )
        np.testing.assert_allclose(state[4], t[chain.link_names.index(name)], atol=1e-5)
    world.close()


def test_a_broken_mesh_is_told_with_its_file(tmp_path):
    (tmp_path / "a.stl").write_bytes(binary_stl(TRIANGLES)[:-7])
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(arm("a.stl"))
    with pytest.raises(UrdfError, match=r"/a\.stl: "):
        mount_from_urdf(urdf, ["tilt"], "eye", [0.0])
    with pytest.raises(UrdfError, match=r"/a\.stl: "):
        Chain.from_urdf(urdf, ["tilt"], "eye")
