import pytest

from coopmap_env.evaluation import file_hashes, get_env_spec
from coopmap_env.robots import make_mount, mount_files, mount_from_json, mount_from_urdf

URDF = """<robot name="pan_tilt">
  <link name="body">
    <inertial><mass value="80"/>
      <inertia ixx="4" iyy="5" izz="7" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><box size="0.7 0.6 0.3"/></geometry></collision>
  </link>
  <joint name="pan" type="revolute">
    <parent link="body"/><child link="pole"/><origin xyz="0 0 0.15"/><axis xyz="0 0 1"/>
    <limit lower="-3.1" upper="3.1" effort="50" velocity="1"/>
  </joint>
  <link name="pole">
    <inertial><mass value="4"/>
      <inertia ixx="0.4" iyy="0.4" izz="0.02" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <joint name="tilt" type="revolute">
    <parent link="pole"/><child link="camera"/><origin xyz="0 0 1.05"/><axis xyz="0 1 0"/>
    <limit lower="0.2" upper="1.0" effort="20" velocity="1"/>
  </joint>
  <link name="camera">
    <inertial><mass value="0.5"/>
      <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
</robot>
"""


@pytest.fixture
def fields(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(URDF, encoding="utf-8")
    return {"urdf": str(path), "joints": ["pan", "tilt"], "camera_link": "camera"}


def test_a_json_object_is_the_mount_of_its_urdf(fields):
    mount = mount_from_json({**fields, "home": [0.5, 0.5], "root_height": 0.3})
    same = mount_from_urdf(fields["urdf"], ["pan", "tilt"], "camera", [0.5, 0.5], root_height=0.3)
    assert (mount.home, mount.joints, mount.camera_link) == ((0.5, 0.5), same.joints, "camera")
    assert mount.urdf.read_text() == same.urdf.read_text()


def test_without_a_home_joints_start_at_zero_or_the_nearest_limit(fields):
    assert mount_from_json(fields).home == (0.0, 0.2)


def test_an_optical_frame_is_turned_into_a_camera(fields):
    x_forward = mount_from_json(fields).T_link_camera.rotation
    assert x_forward.tolist() == [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    optical = mount_from_json({**fields, "optical_frame": True}).T_link_camera.rotation
    assert (optical @ [1, 0, 0]).tolist() == [0, 0, 1]  # the camera's x, along the link's z


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint": ["pan"]}, "a mount has no argument 'joint'; did you mean 'joints'?"),
        ({"camera_link": "eye"}, "no link 'eye' for the camera"),
        ({"joints": ["pan", "roll"]}, "roll"),
        ({"home": [0.0]}, "needs one value for each"),
        ({"home": [0.0, 5.0]}, "home of the mount 'arm'"),
    ],
)
def test_what_does_not_fit_is_one_error(fields, change, message):
    with pytest.raises(ValueError, match=message) as raised:
        mount_from_json({**fields, **change})
    assert "/coopmap" not in str(raised.value), "it names the file of the user"


def test_a_missing_field_is_named(fields):
    del fields["joints"]
    with pytest.raises(ValueError, match=r"mount: .*'joints'"):
        mount_from_json(fields)


def test_environments_take_the_object(fields):
    env = get_env_spec("field").make(mount=[fields, "mast"], n_robots=2)
    assert [mount.name for mount in env.mounts] == ["arm", "mast"]
    env.close()


def test_the_files_of_a_mount_enter_the_hashes(fields, tmp_path):
    before = file_hashes("random", "", "field", fields)
    assert list(before) == [fields["urdf"]]
    assert mount_files(fields) == [tmp_path / "arm.urdf"]
    (tmp_path / "arm.urdf").write_text(URDF.replace('value="80"', 'value="81"'), encoding="utf-8")
    assert file_hashes("random", "", "field", fields) != before


def test_a_urdf_given_as_a_name_is_answered_by_the_function_that_reads_it():
    with pytest.raises(ValueError, match=r"coopmap\.mount_from_urdf\('arm\.urdf', joints=\[...\]"):
        make_mount("arm.urdf")
