import numpy as np
import pytest

from coopmap_env.geometry import Pose
from coopmap_env.mapping import OccupancyMap, VoxelGrid
from coopmap_env.robots import Vehicle, make_mount

ARM = """<robot name="arm">
  <link name="stand"/>
  <joint name="tilt" type="revolute"><origin xyz="0 0 1" rpy="0 0 1.5707963267948966"/>
    <parent link="stand"/><child link="eye"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="eye"><inertial><mass value="0"/></inertial>
    <visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <joint name="flap" type="revolute"><origin xyz="0.3 0 0"/>
    <parent link="eye"/><child link="lid"/><axis xyz="1 0 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <link name="lid"/>
  <joint name="axle" type="continuous"><origin xyz="0 0.2 0.1"/>
    <parent link="stand"/><child link="wheel"/><axis xyz="0 1 0"/></joint>
  <link name="wheel"/>
</robot>"""
NAMES = ("mast", "husky_panda", "tiago")


def mount_or_skip(name):
    """A ready-made mount; its test is skipped where an extra is not installed."""
    try:
        mount = make_mount(name)
        mount.chain()
    except ImportError as error:
        pytest.skip(str(error))
    return mount


@pytest.fixture(scope="session", params=NAMES)
def any_mount(request):
    return mount_or_skip(request.param)


@pytest.fixture(scope="session")
def mast():
    return mount_or_skip("mast")


@pytest.fixture(scope="session")
def somewhere():
    """A vehicle's pose: turned, and not on a voxel's corner."""
    c, s = np.cos(0.7), np.sin(0.7)
    return Pose(np.array([0.52, -0.33, 0.0]), np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]))


@pytest.fixture(scope="session")
def vehicle(mast, somewhere):
    return Vehicle.from_mount(mast, somewhere)


@pytest.fixture
def open_map():
    """All known to be free above the ground, 6 x 6 x 4 m."""
    map_ = OccupancyMap(VoxelGrid((60, 60, 40), 0.1, (-3.0, -3.0, -0.3)))
    index = np.stack(np.unravel_index(np.arange(map_.grid.n_cells), map_.grid.shape), axis=-1)
    map_.mark_free(np.flatnonzero(map_.grid.center(index)[:, 2] > 0))
    return map_


@pytest.fixture
def arm(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "arm.urdf"
    path.write_text(ARM)
    return path
