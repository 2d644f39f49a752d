import numpy as np
import pytest
from plain.kinematics import link_poses, random_joints

from coopmap_env.geometry import Pose
from coopmap_env.robots import Chain
from coopmap_env.robots.kinematics.urdf import UrdfModel

TWO_LINKS = """<robot name="two">
  <link name="root"/>
  <joint name="lift" type="prismatic">
    <origin xyz="1 0 0"/><parent link="root"/><child link="a"/><axis xyz="0 0 2"/>
    <limit lower="0" upper="1" effort="1" velocity="1"/>
  </joint>
  <link name="a"/>
  <joint name="turn" type="continuous">
    <origin xyz="0 0 1"/><parent link="a"/><child link="b"/><axis xyz="0 0 1"/>
  </joint>
  <link name="b"><visual><origin xyz="0.5 0 0"/>
    <geometry><box size="1 0.1 0.1"/></geometry></visual></link>
  <joint name="follower" type="revolute">
    <origin xyz="1 0 0"/><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <limit lower="-9" upper="9" effort="1" velocity="1"/>
    <mimic joint="turn" multiplier="-1" offset="0.5"/>
  </joint>
  <link name="c"><inertial><mass value="3"/><origin xyz="0 0 0.1"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial></link>
</robot>"""


@pytest.fixture
def two_links(tmp_path):
    pytest.importorskip("trimesh")
    path = tmp_path / "two.urdf"
    path.write_text(TWO_LINKS)
    return path


def test_by_hand_a_lift_by_one_half_and_a_quarter_turn(two_links):
    chain = Chain.from_urdf(
        two_links, ("lift", "turn"), "b", Pose(np.array([1.0, 0, 0]), np.eye(3))
    )
    R, t = chain.camera_poses([0.5, np.pi / 2])
    np.testing.assert_allclose(t, [1, 1, 1.5], atol=1e-12)  # root 1 ahead, 1 + 0.5 up, then 1 left
    np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)


def test_by_hand_the_jacobian_slides_up_and_swings_sideways(two_links):
    chain = Chain.from_urdf(
        two_links, ("lift", "turn"), "b", Pose(np.array([1.0, 0, 0]), np.eye(3))
    )
    J = chain.jacobian([0.2, 0.0])
    np.testing.assert_allclose(J[:, 0], [0, 0, 1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(J[:, 1], [0, 1, 0, 0, 0, 1], atol=1e-12)


def test_a_mimic_joint_follows_another(two_links):
    chain = Chain.from_urdf(two_links, ("turn",), "c")
    R, _ = chain.camera_poses([0.3])
    np.testing.assert_allclose(np.arctan2(R[1, 0], R[0, 0]), 0.5, atol=1e-12)  # 0.3 - 0.3 + 0.5


def test_joints_are_frozen_at_given_values(two_links):
    chain = Chain.from_urdf(two_links, ("turn",), "b", fixed_joints={"lift": 0.25})
    np.testing.assert_allclose(chain.camera_poses([0.0])[1], [1, 0, 1.25], atol=1e-12)


def test_masses_centers_and_triangles_are_read(two_links):
    chain = Chain.from_urdf(two_links, ("turn",), "b")
    c, b = chain.link_names.index("c"), chain.link_names.index("b")
    assert chain.masses[c] == 3
    assert chain.masses.sum() == 3
    np.testing.assert_array_equal(chain.centers_of_mass[c], [0, 0, 0.1])
    np.testing.assert_array_equal(chain.inertias[c], np.diag([1, 2, 3]))
    assert chain.meshes[b].shape == (12, 3, 3)
    np.testing.assert_allclose(chain.meshes[b].reshape(-1, 3).max(axis=0), [1, 0.05, 0.05])
    with pytest.raises(ValueError, match="read-only"):
        chain.masses[0] = 1


def test_link_poses_eq_the_plain_ones(any_mount):
    rng = np.random.default_rng(0)
    for with_suspension in (False, True):
        chain = any_mount.chain(with_suspension)
        model = UrdfModel.from_file(any_mount.urdf)
        q = random_joints(chain, rng, 5)
        R, t = chain.link_poses(q)
        Rc, tc = chain.camera_poses(q)
        for k in range(len(q)):
            poses = link_poses(model, dict(zip(chain.joint_names, q[k], strict=True)))
            for i, name in enumerate(chain.link_names):
                np.testing.assert_allclose(R[k, i], poses[name][:3, :3], atol=1e-9)
                np.testing.assert_allclose(t[k, i], poses[name][:3, 3], atol=1e-9)
            camera = any_mount.T_link_camera
            T = poses[any_mount.camera_link]
            np.testing.assert_allclose(tc[k], T[:3, :3] @ camera.translation + T[:3, 3], atol=1e-9)
            np.testing.assert_allclose(Rc[k], T[:3, :3] @ camera.rotation, atol=1e-9)


def test_link_poses_eq_pybullet_on_random_joints(any_mount):
    """Bullet keeps frames of links in single precision: 1e-6."""
    p = pytest.importorskip("pybullet")
    client = p.connect(p.DIRECT)
    try:
        robot = p.loadURDF(str(any_mount.urdf), useFixedBase=True, physicsClientId=client)
        infos = [p.getJointInfo(robot, i, physicsClientId=client) for i in range(
            p.getNumJoints(robot, physicsClientId=client))]  # fmt: skip
        joints = {info[1].decode(): info[0] for info in infos}
        links = {info[12].decode(): info[0] for info in infos}
        masses = [p.getDynamicsInfo(robot, i, physicsClientId=client)[0] for i in joints.values()]
        assert min(masses) > 0  # none is fixed by a missing mass
        chain = any_mount.chain(with_suspension=True)
        assert {info[1].decode() for info in infos if info[2] != p.JOINT_FIXED} == set(
            chain.joint_names
        )
        for q in random_joints(chain, np.random.default_rng(1), 6):
            for name, value in zip(chain.joint_names, q, strict=True):
                p.resetJointState(robot, joints[name], value, physicsClientId=client)
            R, t = chain.link_poses(q)
            for i, name in enumerate(chain.link_names):
                if name in links:
                    state = p.getLinkState(
                        robot, links[name], computeForwardKinematics=True, physicsClientId=client
                    )
                    matrix = np.reshape(p.getMatrixFromQuaternion(state[5]), (3, 3))
                    np.testing.assert_allclose(t[i], state[4], atol=1e-6)
                    np.testing.assert_allclose(R[i], matrix, atol=1e-6)
    finally:
        p.disconnect(client)


def test_the_jacobian_eq_finite_differences(any_mount):
    chain = any_mount.chain(with_suspension=True)
    for q in random_joints(chain, np.random.default_rng(2), 3):
        J = chain.jacobian(q)
        for n in range(chain.n_joints):
            h = 1e-6 * np.eye(chain.n_joints)[n]
            (R0, R1), (t0, t1) = chain.camera_poses(np.stack([q - h, q + h]))
            np.testing.assert_allclose(J[:3, n], (t1 - t0) / 2e-6, atol=1e-7)
            W = (R1 - R0) @ chain.camera_poses(q)[0].T / 2e-6
            np.testing.assert_allclose(J[3:, n], [W[2, 1], W[0, 2], W[1, 0]], atol=1e-7)


def test_at_rest_both_chains_agree(any_mount):
    R, t = any_mount.chain().camera_poses(any_mount.home)
    R2, t2 = any_mount.chain(with_suspension=True).camera_poses([0, 0, 0, *any_mount.home])
    np.testing.assert_allclose(R, R2, atol=1e-12)
    np.testing.assert_allclose(t, t2, atol=1e-12)


def test_the_joint_at_fault_is_named(mast):
    chain = mast.chain()
    with pytest.raises(ValueError, match=r"shape \(2,\), expected \(5,\).*turntable"):
        chain.camera_poses([0, 0])
    with pytest.raises(ValueError, match="joint 'elbow' has a value that is not finite"):
        chain.link_poses([0, 0, np.nan, 0, 0])
    with pytest.raises(ValueError, match=r"'elbow' at 2.5 is outside of its limits \[0.2, 2\]"):
        chain.check_limits([[0, 0, 1, 0, 0], [0, 0, 2.5, 0, 0]])


def test_unknown_joints_and_links_are_answered_by_those_that_exist(mast):
    with pytest.raises(ValueError, match=r"no moving joint 'knee'; it has.*'turntable'"):
        Chain.from_urdf(mast.urdf, ("knee",), "camera")
    with pytest.raises(ValueError, match="no moving joint 'camera_mount'"):
        Chain.from_urdf(mast.urdf, ("turntable",), "camera", fixed_joints={"camera_mount": 1.0})
    with pytest.raises(ValueError, match=r"no link 'eye' for the camera; it has.*'head'"):
        Chain.from_urdf(mast.urdf, ("turntable",), "eye")
    with pytest.raises(ValueError, match="named twice"):
        Chain.from_urdf(mast.urdf, ("turntable", "turntable"), "camera")
    with pytest.raises(FileNotFoundError, match="no URDF at /nowhere"):
        Chain.from_urdf("/nowhere/a.urdf", ("a",), "b")
