"""PyBullet: clients, vehicles and solids in it, what touches what, and its renderer."""

import gc
import hashlib
import math
import os
import subprocess
import sys
import weakref
from pathlib import Path

import numpy as np
import pytest
from plain.bullet_renderer import BulletRenderer
from plain.crane import ROLL_CENTRE_HEIGHT, crane
from plain.field_worlds import base_pose, cluttered_world, crate, flat_world

from coopmap_env.geometry import Pose, random_rotation
from coopmap_env.robots import Suspension, make_mount
from coopmap_env.sensing import DepthCamera
from coopmap_env.simulation.physics import SteppingSettings, move_kinematically, move_stepped
from coopmap_env.simulation.physics._joint_map import JointMap
from coopmap_env.simulation.physics.client import BulletClient, quaternion_from_matrix
from coopmap_env.simulation.physics.world import OWN_BODY, BulletWorld
from coopmap_env.simulation.scenes.field import Solid

pybullet = pytest.importorskip("pybullet")


def mount_or_skip(name):
    try:
        return make_mount(name)
    except ImportError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="module")
def mast():
    return make_mount("mast")


@pytest.fixture
def opened():
    """Makes worlds and closes them."""
    worlds = []

    def open_(world, mounts):
        worlds.append(BulletWorld(world.solids, mounts, world.base_poses))
        return worlds[-1]

    yield open_
    for world in worlds:
        world.close()


def put(world, robot, joints):
    world.set_configuration(
        robot, world.rest_configurations(robot, np.array([joints], dtype=float))[0]
    )
    world.find_contacts()
    return world.contacts()


def test_only_one_file_imports_pybullet():
    package = Path(__file__).parents[2]
    folders = ("coopmap_env", "baselines", "agents")
    files = [file for folder in folders for file in (package / folder).rglob("*.py")]
    using = [file.name for file in files if 'import_optional("pybullet"' in file.read_text()]
    assert using == ["client.py"]
    assert not [file for file in files if "import pybullet\n" in file.read_text()]


def test_quaternions_rotate_as_their_matrices():
    rng = np.random.default_rng(0)
    half_turn = np.diag([1.0, -1.0, -1.0])
    for R in [np.eye(3), half_turn, *(random_rotation(rng) for _ in range(20))]:
        matrix = pybullet.getMatrixFromQuaternion(quaternion_from_matrix(R))
        assert np.reshape(matrix, (3, 3)) == pytest.approx(R, abs=1e-12)


@pytest.mark.parametrize("name", ["mast", "husky_panda", "tiago"])
def test_links_are_where_the_kinematics_say(name, opened):
    mount = mount_or_skip(name)
    chain = mount.chain(with_suspension=True)
    where = base_pose(1.3, -0.4, 2.1)
    world = opened(flat_world(bases=[base_pose(0, 0), where]), [mount, mount])
    rng = np.random.default_rng(1)
    vehicle = world.vehicles[1]
    for _ in range(3):
        q = np.append([0.01, 0.02, -0.03], rng.uniform(chain.lower[3:], chain.upper[3:]))
        world.set_configuration(1, q)
        k = {"physicsClientId": world.client.id}
        R, t = chain.link_poses(q)
        for j, link in enumerate(vehicle.joint_map.link_names[1:]):
            i = chain.link_names.index(link)
            state = pybullet.getLinkState(vehicle.number, j, computeForwardKinematics=1, **k)
            # PyBullet keeps poses in single precision here and there
            assert state[4] == pytest.approx(where.transform(t[i]), abs=2e-6)
            turned = np.reshape(pybullet.getMatrixFromQuaternion(state[5]), (3, 3))
            assert turned == pytest.approx(where.rotation @ R[i], abs=2e-6)


def test_the_arm_is_what_the_joints_move(mast):
    joint_map = JointMap.from_mount(mast)
    names = {joint_map.link_names[j + 1] for j in joint_map.arm}
    assert names == {"post", "upper_arm", "forearm", "wrist", "head", "camera"}
    pairs = [
        (joint_map.link_names[a + 1], joint_map.link_names[b + 1])
        for a, b in joint_map.ignored_pairs
    ]
    # the camera is a frame in the head, without a shape; only the post stands on the chassis
    assert {a for a, b in pairs if b == "chassis"} == {"post", "camera"}
    assert JointMap.from_mount(make_mount("mast")) is joint_map


def test_at_home_nothing_touches(mast, opened):
    world = opened(flat_world(bases=[base_pose(0, 0), base_pose(2.5, 0)]), [mast, mast])
    world.find_contacts()
    assert world.contacts() == [(0.0, ""), (0.0, "")]


def test_an_arm_in_a_crate_is_in_contact_and_one_beside_it_is_not(mast, opened):
    """Straight up, the arm ends 2.2 m above ground; a crate of 0.2 m hangs there, then higher."""
    up = (0.0, 0.0, 0.2, 0.0, 0.0)
    low = opened(flat_world(crate("low", 0.05, 0.0, 1.9, 0.2)), [mast])
    high = opened(flat_world(crate("high", 0.05, 0.0, 2.8, 0.2)), [mast])
    depth, what = put(low, 0, up)[0]
    assert what == "low"
    assert depth < -0.01
    assert put(high, 0, up) == [(0.0, "")]


def test_both_arms_report_their_contact(mast, opened):
    """Two masts 1.6 m apart that lean towards each other."""
    world = opened(flat_world(bases=[base_pose(-0.8, 0), base_pose(0.8, 0, math.pi)]), [mast, mast])
    put(world, 0, (0.0, 0.8, 0.2, 0.0, 0.0))
    (d0, what0), (d1, what1) = put(world, 1, (0.0, 0.8, 0.2, 0.0, 0.0))
    assert (what0, what1) == ("robot_1", "robot_0")
    assert d0 == d1 < 0


def test_an_arm_on_its_own_body_is_in_contact(opened):
    mount = mount_or_skip("husky_panda")
    world = opened(flat_world(), [mount])
    folded = np.array(mount.home)
    folded[[1, 3, 5]] = 1.7, -1.2, 2.0  # down onto the deck
    assert put(world, 0, folded)[0][1] == OWN_BODY


def test_a_concave_solid_can_be_stood_in(mast, opened):
    """Its triangles count, not their hull: the arm stands free in a hollow box."""
    box = crate("tent", 0.0, 0.0, 1.5, 3.4)
    hollow = Solid("tent", box.vertices, box.faces, is_target=True, is_concave=True)
    up, out = (0.0, 0.0, 0.2, 0.0, 0.0), (0.0, 0.8, 0.9, 0.0, 0.0)
    assert put(opened(flat_world(hollow), [mast]), 0, up) == [(0.0, "")]
    assert put(opened(flat_world(box), [mast]), 0, up)[0][1] == "tent"
    narrow = crate("tent", 0.0, 0.0, 1.5, (1.0, 3.4, 3.4))
    hollow = Solid("tent", narrow.vertices, narrow.faces, is_target=True, is_concave=True)
    assert put(opened(flat_world(hollow), [mast]), 0, out)[0][1] == "tent"


@pytest.mark.parametrize("bases", [1, 29])
def test_as_many_mounts_as_base_poses(mast, bases):
    with pytest.raises(ValueError, match=r"2 mounts and|29 mounts and"):
        BulletWorld((), [mast] * (2 if bases == 1 else bases), [base_pose(0, 0)] * bases)


def test_a_closed_world_says_so(mast):
    world = BulletWorld((), [mast], [base_pose(0, 0)])
    world.close()
    world.close()
    for use in (world.find_contacts, world.contacts, world.step, lambda: world.velocity(0)):
        with pytest.raises(RuntimeError, match="closed"):
            use()


@pytest.mark.parametrize(
    "q", [np.zeros(2), np.zeros((1, 8)), np.full(8, np.nan), [0.0] * 7 + [np.inf]]
)
def test_a_configuration_that_is_none_changes_nothing(mast, opened, q):
    world = opened(flat_world(bases=[base_pose(-2, 0), base_pose(2, 0)]), [mast] * 2)
    before = [own.copy() for own in world.q]
    with pytest.raises(ValueError, match="configuration of robot 1 must be 8 finite values"):
        world.set_configuration(1, q)
    for own, then in zip(world.q, before, strict=True):
        np.testing.assert_array_equal(own, then)
    world.find_contacts()
    assert [contact.obstacle for contact in world.contacts()] == ["", ""]


def test_a_configuration_is_that_of_the_call(mast, opened):
    world = opened(flat_world(), [mast])
    q = world.q[0].copy()
    world.set_configuration(0, q)
    q[4] += 0.5
    world.velocity(0)
    assert world.q[0][4] == pytest.approx(q[4] - 0.5)


def test_a_hundred_worlds_leave_nothing_behind(mast):
    """Clients are closed, also when forgotten, and memory does not grow; PyBullet has 1024."""

    def pages():
        return int(Path("/proc/self/statm").read_text().split()[1])

    world = cluttered_world(0, [base_pose(0, 0)])
    mounts = [mast]
    forgotten = []
    if not Path("/proc/self/statm").exists():
        pytest.skip("needs /proc")
    for k in range(100):
        physics = BulletWorld(world.solids, mounts, world.base_poses)
        physics.step()
        number = physics.client.id
        if k % 2:
            physics.close()
        else:
            forgotten.append(weakref.ref(physics.client))
        del physics
        if k == 40:
            before = pages()
    gc.collect()
    assert not any(client() for client in forgotten)
    assert not pybullet.getConnectionInfo(number)["isConnected"]
    assert (pages() - before) * 4096 < 4e6  # one world's solids alone would be 10 MB after 60


def bounce(physics, h, steps):
    """Heave of a crane (90 kg) that is let go 10 mm above its rest."""
    physics.set_configuration(0, np.array([0.01, 0.0, 0.0, 0.0]))
    physics.set_time_step(h)
    physics.set_motor_targets(0, np.zeros(1))
    heave = []
    for _ in range(steps):
        physics.step()
        physics.velocity(0)
        heave.append(physics.q[0][0])
    return np.array(heave)


def test_a_bouncing_body_follows_the_implicit_step(tmp_path, opened):
    """v' = (v - h k s / m) / (1 + (h d + h^2 k) / m), s' = s + h v', by hand."""
    springs = Suspension(
        heave_stiffness=60_000.0, heave_damping=400.0, roll_center_height=ROLL_CENTRE_HEIGHT
    )
    physics = opened(flat_world(), [crane(tmp_path, suspension=springs)])
    for h in (1 / 120, 1 / 30, 1 / 10):
        s, v, expected = 0.01, 0.0, []
        for _ in range(20):
            v = (v - h * 60_000 * s / 90.002) / (1 + (h * 400 + h * h * 60_000) / 90.002)
            s += h * v
            expected.append(s)
        assert bounce(physics, h, 20) == pytest.approx(expected, abs=1e-4)  # Bullet damps too


@pytest.mark.parametrize("stiffness", [60_000.0, 6e7])
@pytest.mark.parametrize("damping", [0.0, 4_100.0, 4e5])
def test_no_spring_swings_up_however_stiff_it_is(tmp_path, opened, stiffness, damping):
    springs = Suspension(
        heave_stiffness=stiffness, heave_damping=damping, roll_center_height=ROLL_CENTRE_HEIGHT
    )
    physics = opened(flat_world(), [crane(tmp_path, suspension=springs)])
    heave = np.abs(bounce(physics, 0.1, 60))
    assert heave.max() <= 0.01
    assert heave[-1] < 1e-3 or damping > stiffness  # that one creeps


def test_springs_are_in_balance_at_the_equilibrium_only(mast, opened):
    physics = opened(flat_world(), [mast])
    q = physics.rest_configurations(0, np.array([[0.5, 0.8, 0.9, 0.0, 0.0]]))[0]
    physics.set_configuration(0, q)
    assert physics.spring_imbalance(0) < 5e-6
    # a millimetre of heave; a thousandth of roll, less what the weight adds to it
    for deflection in ([1e-3, 0, 0, 0, 0, 0, 0, 0], [0, 1e-3, 0, 0, 0, 0, 0, 0]):
        physics.set_configuration(0, q + deflection)
        assert physics.spring_imbalance(0) == pytest.approx(1e-3, rel=0.2)


def test_the_renderer_sees_a_crate_where_it_is():
    """A face 2 m ahead fills the image; over its edge there is nothing."""
    camera = DepthCamera(width=32, height=24)
    scene = [crate("crate", 2.5, 0.0, 0.0, (1.0, 9.0, 1.0))]
    renderer = BulletRenderer(scene, [], [])
    image = renderer.depth_image(camera, Pose(np.zeros(3), np.eye(3)))
    renderer.close()
    # half a metre at 2 m is 14 degrees of the 22.5 above and below: rows 5 to 18
    assert image[7:17] == pytest.approx(np.full((10, 32), 2.0), abs=2e-3)
    assert np.isinf(image[[0, -1]]).all()
    with pytest.raises(RuntimeError, match="closed"):
        renderer.depth_image(camera, Pose(np.zeros(3), np.eye(3)))


RUN = """
from simulation.test_bullet import fingerprint
print(fingerprint(5))
"""


def fingerprint(seed):
    """All bits of where two vehicles end, contacts among it, in both kinds of physics."""
    mast = make_mount("mast")
    bases = [base_pose(-0.9, 0.0), base_pose(0.9, 0.0, math.pi)]
    world = cluttered_world(seed, bases, n=90, nearest=0.6)
    rng = np.random.default_rng(seed)
    goals = rng.uniform(mast.chain().lower, mast.chain().upper, (12, 2, 5))
    digest, touched = hashlib.sha256(), 0
    for stepped in (False, True):
        physics = BulletWorld(world.solids, [mast, mast], bases)
        for pair in goals:
            if stepped:
                what = move_stepped(physics, list(pair), SteppingSettings())
            else:
                what = [move_kinematically(physics, robot, q) for robot, q in enumerate(pair)]
            touched += sum(map(bool, what))
            digest.update(np.concatenate(physics.q).tobytes() + "".join(what).encode())
        physics.close()
    assert touched >= 4  # it is contacts that are hard to repeat
    return digest.hexdigest()


def test_the_same_moves_end_in_the_same_bits_whatever_ran_before():
    first = fingerprint(5)
    other = fingerprint(6)
    assert fingerprint(5) == first
    assert other != first


def test_the_same_moves_end_in_the_same_bits_in_another_process():
    tests = Path(__file__).parents[1]
    run = subprocess.run(
        [sys.executable, "-c", RUN], cwd=tests, capture_output=True, text=True, check=True,
        env={**os.environ, "PYTHONPATH": f"{tests}:{':'.join(sys.path)}"},
    )  # fmt: skip
    assert run.stdout.split()[-1] == fingerprint(5)


def test_rays_state_the_fraction_of_their_length_at_which_they_hit(yard_client):
    origins = np.array([[-2.0, 0.0, 0.5], [-2.0, 0.0, 5.0]])
    fractions = yard_client.cast_rays(origins, origins + np.array([4.0, 0.0, 0.0]))
    np.testing.assert_allclose(fractions, [0.375, 1.0], atol=1e-3)  # hulls have a skin of 1 mm


@pytest.fixture
def yard_client():
    client = BulletClient()
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
    client.p.createMultiBody(0, client.create_shape(corners), physicsClientId=client.id)
    yield client
    client.close()
