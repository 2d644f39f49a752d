"""Links of a wrapped URDF are where those of the URDF itself are, whatever moves and is frozen."""

import numpy as np
import pytest
from plain.kinematics import rotation_about_axis

from coopmap_env.geometry import Pose
from coopmap_env.robots import Chain, Mount, UrdfModel, mount_from_urdf

pytest.importorskip("trimesh")

LINKS = ("a", "b", "c", "d", "e", "f", "camera")
FOLLOWERS = {  # name: (source, multiplier, offset); in the file before what they follow
    "leveller": ("boom", -1.0, 0.0),
    "slide": ("leveller", 0.5, 0.1),
    "flap": ("slide", 2.0, -0.3),
    "lid": ("latch", 3.0, 0.2),
}
FREE = ("boom", "turn")
LATCH = 0.4


def _joint(name, kind, parent, child, axis, extra=""):
    limit = 'lower="-3" upper="3"'
    if name == "latch":
        limit = f'lower="{LATCH}" upper="{LATCH}"'
    mimic = ""
    if name in FOLLOWERS:
        source, multiplier, offset = FOLLOWERS[name]
        mimic = f'<mimic joint="{source}" multiplier="{multiplier}" offset="{offset}"/>'
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="0.3 0.1 0.2" rpy="0.1 0.2 0.3"/><axis xyz="{axis}"/>'
        f'<limit {limit} effort="1000" velocity="2"/>{mimic}{extra}</joint>'
    )


JOINTS = (  # kind, parent, child, axis
    ("flap", "prismatic", "d", "e", (0, 1, 0)),
    ("slide", "prismatic", "c", "d", (0, 0, 2)),
    ("lid", "revolute", "e", "f", (1, 1, 0)),
    ("boom", "revolute", "a", "b", (0, 1, 0)),
    ("leveller", "revolute", "b", "c", (0, 1, 0)),
    ("latch", "revolute", "f", "camera", (0, 0, 1)),
    ("turn", "continuous", "root", "a", (0, 0, 1)),
)
BOX = '<geometry><box size="0.1 0.1 0.1"/></geometry>'
BOOM = (
    '<robot name="boom"><link name="root"><inertial><mass value="140"/><inertia ixx="9" ixy="0" '
    'ixz="0" iyy="9" iyz="0" izz="9"/></inertial></link>'
    + "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="0.01" ixy="0" ixz="0" '
        'iyy="0.01" iyz="0" izz="0.01"/></inertial>'
        f"<visual>{BOX}</visual><collision>{BOX}</collision></link>"
        for name in LINKS
    )
    + "".join(
        _joint(name, kind, parent, child, " ".join(map(str, axis)))
        for name, kind, parent, child, axis in JOINTS
    )
    + "</robot>"
)


def _value(name, values):
    """The value of a joint by the definition of mimic joints, one after the other."""
    if name in FOLLOWERS:
        source, multiplier, offset = FOLLOWERS[name]
        return multiplier * _value(source, values) + offset
    return LATCH if name == "latch" else values.get(name, 0.0)


def _expected_poses(values):
    """T_root_link of every link, by name, from the definition of the URDF's joints."""
    x, y, z = np.eye(3)
    R = rotation_about_axis(z, 0.3) @ rotation_about_axis(y, 0.2) @ rotation_about_axis(x, 0.1)
    origin = np.eye(4)
    origin[:3, :3], origin[:3, 3] = R, (0.3, 0.1, 0.2)
    poses, left = {"root": np.eye(4)}, list(JOINTS)
    while left:
        for row in [row for row in left if row[2] in poses]:
            name, kind, parent, child, axis = row
            T, value = np.eye(4), _value(name, values)
            if kind == "prismatic":
                T[:3, 3] = value * np.array(axis) / np.linalg.norm(axis)
            else:
                T[:3, :3] = rotation_about_axis(axis, value)
            poses[child] = poses[parent] @ origin @ T
            left.remove(row)
    return poses


@pytest.fixture
def boom(tmp_path):
    path = tmp_path / "boom.urdf"
    path.write_text(BOOM)
    return path


@pytest.mark.parametrize("moving", [("boom",), ("turn",), ("boom", "turn"), ("turn", "boom")])
def test_wrapped_links_are_where_the_unwrapped_ones_are_for_all_values(boom, moving):
    rng = np.random.default_rng(0)
    for _ in range(5):
        frozen = {name: float(rng.uniform(-1, 1)) for name in FREE if name not in moving}
        mount = mount_from_urdf(
            boom, moving, "camera", [0.0] * len(moving), fixed_joints=frozen, root_height=0.5
        )
        q = rng.uniform(-1, 1, len(moving))
        expected = _expected_poses({**frozen, **dict(zip(moving, q, strict=True))})
        chain = mount.chain()
        R, t = chain.link_poses(q)
        for link, T in expected.items():
            at = chain.link_names.index(link)
            np.testing.assert_allclose(R[at], T[:3, :3], atol=1e-12)
            np.testing.assert_allclose(t[at], T[:3, 3] + [0, 0, 0.5], atol=1e-12)


def test_a_chain_of_the_unwrapped_urdf_has_the_same_poses(boom):
    expected = _expected_poses({"boom": 0.6, "turn": -0.2})
    chain = Chain.from_urdf(boom, ("boom",), "camera", fixed_joints={"turn": -0.2})
    np.testing.assert_allclose(chain.camera_poses([0.6])[1], expected["camera"][:3, 3], atol=1e-12)
    poses = UrdfModel.from_file(boom).link_poses({"boom": 0.6, "turn": -0.2})
    for link, T in expected.items():
        np.testing.assert_allclose(poses[link], T, atol=1e-12)


def test_the_physics_engine_moves_mimic_joints_as_the_kinematics_say(boom):
    """After a reset and after steps under gravity; PyBullet knows no mimic joints itself."""
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import BulletWorld, SteppingSettings, move_stepped

    mount = mount_from_urdf(boom, ("boom", "turn"), "camera", [0.0, 0.0], root_height=0.5)
    world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
    vehicle, chain = world.vehicles[0], mount.chain(with_suspension=True)
    q = np.array([0.0, 0.0, 0.0, 0.5, -0.4])

    def check(q, tolerance):
        R, t = chain.link_poses(q)
        for j, name in enumerate(vehicle.joint_map.link_names[1:]):
            state = world.client.p.getLinkState(
                vehicle.number, j, computeForwardKinematics=1, physicsClientId=world.client.id
            )
            at = chain.link_names.index(name)
            np.testing.assert_allclose(t[at], state[4], atol=tolerance)
            matrix = np.reshape(world.client.p.getMatrixFromQuaternion(state[5]), (3, 3))
            np.testing.assert_allclose(R[at], matrix, atol=tolerance)

    world.set_configuration(0, q)
    check(q, 1e-6)
    goal = np.array([-0.3, 0.6])
    assert move_stepped(world, [goal], SteppingSettings()) == [""]
    np.testing.assert_allclose(world.q[0][3:], goal, atol=1e-3)
    check(world.q[0], 1e-3)
    world.close()


def test_a_urdf_that_is_a_mount_as_it_is_stands_alike_in_the_physics(boom):
    """Without `mount_from_urdf`: joints with equal limits and chains of mimic joints included."""
    pytest.importorskip("pybullet")
    from coopmap_env.simulation.physics import BulletWorld

    mount = Mount("boom", boom, "camera", ("boom", "turn"), (0.3, 0.2))
    world = BulletWorld([], [mount], [Pose(np.zeros(3), np.eye(3))])
    vehicle = world.vehicles[0]
    camera = vehicle.joint_map.link_names.index("camera") - 1
    state = world.client.p.getLinkState(
        vehicle.number, camera, computeForwardKinematics=1, physicsClientId=world.client.id
    )
    expected = _expected_poses({"boom": 0.3, "turn": 0.2})["camera"]
    np.testing.assert_allclose(state[4], expected[:3, 3], atol=1e-6)
    world.close()


def test_a_mimic_joint_neither_moves_by_itself_nor_is_fixed_elsewhere(boom):
    with pytest.raises(ValueError, match=r"'flap' of .*boom.urdf mimics 'boom', so it does not"):
        mount_from_urdf(boom, ["flap"], "camera", [0.0])
    with pytest.raises(ValueError, match=r"'leveller' .* mimics 'boom', which moves"):
        mount_from_urdf(boom, ["boom"], "camera", [0.0], fixed_joints={"leveller": 0.2})
    with pytest.raises(ValueError, match=r"'leveller' .* puts it at -0.2: .* fixed at 0.3"):
        mount_from_urdf(
            boom, ["turn"], "camera", [0.0], fixed_joints={"boom": 0.2, "leveller": 0.3}
        )
    same = mount_from_urdf(
        boom, ["turn"], "camera", [0.0], fixed_joints={"boom": 0.2, "leveller": -0.2}
    )
    np.testing.assert_allclose(
        same.chain().camera_poses([0.0])[1],
        _expected_poses({"boom": 0.2})["camera"][:3, 3],
        atol=1e-12,
    )
    with pytest.raises(ValueError, match="no moving joint 'latch'"):
        mount_from_urdf(boom, ["latch"], "camera", [0.0])
    with pytest.raises(
        ValueError, match="the value of the joint 'boom' must be a finite number, got nan"
    ):
        mount_from_urdf(boom, ["turn"], "camera", [0.0], fixed_joints={"boom": np.nan})
    with pytest.raises(ValueError, match=r"'boom' of .* is to move and has a fixed value"):
        mount_from_urdf(boom, ["boom"], "camera", [0.0], fixed_joints={"boom": 0.0})


def test_a_circle_of_mimic_joints_or_an_unknown_one_is_named(boom):
    boom.write_text(BOOM.replace("</robot>", _joint("x", "revolute", "a", "g", "1 0 0",
        '<mimic joint="x"/>') + '<link name="g"/></robot>'))  # fmt: skip
    with pytest.raises(ValueError, match=r"boom.urdf: the joints \['x'\] mimic each other"):
        UrdfModel.from_file(boom)
    boom.write_text(BOOM.replace('<mimic joint="boom"', '<mimic joint="flap"'))
    with pytest.raises(
        ValueError, match=r"boom.urdf: the joints \['flap', 'slide', 'leveller'\] mimic each other"
    ):
        UrdfModel.from_file(boom)
    boom.write_text(BOOM.replace('<mimic joint="boom"', '<mimic joint="bom"'))
    with pytest.raises(
        ValueError, match=r"boom.urdf: joint 'leveller' mimics 'bom', and there is no such joint"
    ):
        UrdfModel.from_file(boom)


def test_the_fingers_of_the_panda_close_together():
    """A real file: a finger that is frozen at 20 mm has the other one at 20 mm as well."""
    pytest.importorskip("pybullet_data")
    import pybullet_data

    urdf = f"{pybullet_data.getDataPath()}/franka_panda/panda.urdf"
    chain = mount_from_urdf(
        urdf, ["panda_joint1"], "panda_hand", [0.0], fixed_joints={"panda_finger_joint1": 0.02}
    ).chain()
    fingers = [chain.link_names.index(f"panda_{side}finger") for side in ("left", "right")]
    _, t = chain.link_poses([0.3])
    assert np.linalg.norm(t[fingers[0]] - t[fingers[1]]) == pytest.approx(0.04, abs=1e-12)
