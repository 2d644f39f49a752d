"""PyBullet gets meshes that we have read: the same vertices, and none that ends the process."""

import struct
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from coopmap_env.robots import UrdfError, mount_from_urdf

pytest.importorskip("trimesh")

CORNERS = "0 0 0 1 0 0 0 2 0 0 0 3"
OBJ = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\n"
DAE = (
    "<COLLADA><asset>{unit}<up_axis>Z_UP</up_axis></asset>"
    '<library_geometries><geometry id="g"><mesh><source id="s"><float_array id="a" count="12">'
    f'{CORNERS}</float_array><technique_common><accessor source="#a" count="4" stride="3"/>'
    '</technique_common></source><vertices id="v"><input semantic="POSITION" source="#s"/>'
    '</vertices><polylist count="4"><input semantic="VERTEX" source="#v" offset="0"/>'
    "<vcount>3 3 3 3</vcount><p>0 2 1 0 1 3 0 3 2 1 2 3</p></polylist></mesh></geometry>"
    "</library_geometries></COLLADA>"
)


def _stl(corner):
    triangle = struct.pack("<12fH", *(0.0,) * 3, *(corner,) * 3, *(0.0,) * 3, 1.0, 0.0, 0.0, 0)
    return b"\0" * 80 + struct.pack("<I", 1) + triangle


@pytest.fixture
def mount_of(tmp_path):
    def make(name, content):
        (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
        (tmp_path / "arm.urdf").write_text(
            '<robot name="arm"><link name="root"><visual><geometry><box size="1 1 1"/></geometry>'
            f'</visual><collision><geometry><mesh filename="{name}"/></geometry></collision></link>'
            '<link name="camera"/><joint name="turn" type="revolute"><parent link="root"/>'
            '<child link="camera"/><axis xyz="0 0 1"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
        )
        return mount_from_urdf(tmp_path / "arm.urdf", ["turn"], "camera", [0.0])

    return make


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.obj", OBJ + "f 2 3 40000000\n", "a face names vertex 39999999"),
        ("a.obj", OBJ + "f -1 -2 -30000\n", "names a vertex that does not exist"),
        ("a.obj", OBJ.replace("v 1 0 0", "v nan 0 0"), "not nan"),
        ("a.obj", "v 0 0 0\n", "no triangles"),
        ("a.stl", _stl(np.nan), "not nan"),
        ("a.stl", b"\0" * 84, "no triangles"),
    ],
)
def test_a_broken_mesh_of_a_collision_shape_is_named_before_pybullet_reads_it(
    mount_of, tmp_path, name, content, reason
):
    """The link has a visual shape, so nobody else reads its collision shape."""
    with pytest.raises(UrdfError, match=reason) as caught:
        mount_of(name, content)
    assert str(caught.value).startswith(str(tmp_path / name))


@pytest.mark.parametrize(
    ("unit", "metres"), [("", 1.0), ('<unit name="x"/>', 1.0), ('<unit meter="0.0254"/>', 0.0254)]
)
def test_pybullet_gets_the_vertices_of_a_dae_whatever_it_could_read_itself(mount_of, unit, metres):
    """By itself it knows no polygons, and crashes at a unit without ``meter``."""
    pytest.importorskip("pybullet")
    from coopmap_env.geometry import Pose
    from coopmap_env.simulation.physics import BulletWorld

    mount = mount_of("a.dae", DAE.format(unit=unit))
    world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
    vehicle = world.vehicles[0]
    at = vehicle.joint_map.link_names.index("root") - 1
    box = world.client.p.getAABB(vehicle.number, at, physicsClientId=world.client.id)
    world.close()
    np.testing.assert_allclose(np.diff(box, axis=0)[0], metres * np.array([1, 2, 3]), atol=0.01)


def test_a_copy_of_a_mesh_that_was_swept_away_is_written_again(mount_of, tmp_path):
    urdf = mount_of("a.dae", DAE.format(unit="")).urdf
    (mesh,) = ElementTree.parse(urdf).iter("mesh")
    copy = Path(mesh.get("filename"))
    content = copy.read_bytes()
    copy.unlink()
    mount_from_urdf(tmp_path / "arm.urdf", ["turn"], "camera", [0.0])
    assert copy.read_bytes() == content
