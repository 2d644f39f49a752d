import builtins
import dataclasses
import importlib.metadata
import math
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from coopmap_env.robots import Suspension, make_mount, mount_from_urdf
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_loading import (
    load_urdf_xml,
    read_origin,
    write_origin,
    write_urdf_cached,
)
from coopmap_env.robots.kinematics.urdf_xml import transform_from_xyz_rpy


def test_the_camera_of_the_mast_stands_between_one_and_two_and_a_half_metres(mast):
    chain = mast.chain()
    q = np.random.default_rng(0).uniform(chain.lower, chain.upper, (2000, chain.n_joints))
    heights = chain.camera_poses(q)[1][:, 2]
    assert heights.min() > 0.6
    assert heights.max() < 2.4
    assert np.mean(heights > 1.2) > 0.9
    assert 1.6 < chain.camera_poses(mast.home)[1][2] < 1.9


def test_at_home_the_camera_looks_ahead_upright_and_a_little_down(any_mount):
    R, _ = any_mount.chain().camera_poses(any_mount.home)
    assert R[0, 0] > 0.95  # optical axis forward
    assert -0.3 < R[2, 0] < 0.0  # and down
    assert R[1, 1] > 0.99  # left is left


def test_at_home_no_own_triangle_is_in_sight(any_mount):
    """Within 60 x 45 degrees; what lies behind the camera does not count."""
    chain = any_mount.chain()
    R, t = chain.link_poses(any_mount.home)
    Rc, tc = chain.camera_poses(any_mount.home)
    for link, triangles in enumerate(chain.meshes):
        points = _dense(triangles, 0.02) @ R[link].T + t[link]
        x, y, z = ((points - tc) @ Rc).T
        seen = (x > 0) & (abs(y) < x * math.tan(math.pi / 6)) & (abs(z) < x * math.tan(math.pi / 8))
        assert not seen.any(), chain.link_names[link]


def test_the_suspended_mass_of_the_mast_is_damped_as_documented(mast):
    """A damping ratio of 0.7 in heave, roll and pitch about the roll center, at home."""
    chain, suspension = mast.chain(with_suspension=True), mast.suspension
    R, t = chain.link_poses([0, 0, 0, *mast.home])
    body = chain.link_body >= 3
    masses = chain.masses[body]
    at = (t + np.einsum("lij,lj->li", R, chain.centers_of_mass))[body]
    at = at - [0, 0, suspension.roll_center_height]
    turned = np.einsum("lij,ljk,lmk->lim", R, chain.inertias, R)[body]
    inertia = turned.sum(axis=0) + sum(
        m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, at, strict=True)
    )
    effective = [masses.sum(), inertia[0, 0], inertia[1, 1]]
    for c, k, m in zip(suspension.damping, suspension.stiffness, effective, strict=True):
        assert 0.6 < c / (2 * math.sqrt(k * m)) < 0.8
    # swung out sideways, the mast leans the body by tenths of a degree
    R, t = chain.link_poses([0, 0, 0, math.pi / 2, 0.8, 0.8, 0, 0])
    side = (t + np.einsum("lij,lj->li", R, chain.centers_of_mass))[body][:, 1] @ masses * 9.81
    assert 0.2 < math.degrees(side / suspension.roll_stiffness) < 1.5


def test_heave_roll_and_pitch_move_the_camera_as_their_names_say(any_mount):
    chain = any_mount.chain(with_suspension=True)
    J = chain.jacobian([0, 0, 0, *any_mount.home])
    np.testing.assert_allclose(J[:, 0], [0, 0, 1, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(J[3:, 1], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(J[3:, 2], [0, 1, 0], atol=1e-12)


def test_wheels_stay_on_the_ground_when_the_body_rolls():
    pytest.importorskip("pybullet_data")
    mount = make_mount("husky_panda")
    chain = mount.chain(with_suspension=True)
    links = [chain.link_names.index(f"{end}_left_wheel_link") for end in ("front", "rear")]
    _, t = chain.link_poses([[0, 0, 0, *mount.home], [0.05, 0.1, 0.1, *mount.home]])
    np.testing.assert_array_equal(t[0, links], t[1, links])
    np.testing.assert_allclose(t[0, links, 2], 0.17775, atol=1e-9)  # the wheels' radius


def test_any_urdf_becomes_a_mount(arm):
    mount = mount_from_urdf(
        arm, ["tilt"], "eye", [0.2], root_height=0.3, wheels=["wheel"], fixed_joints={"flap": 0.5}
    )
    chain = mount.chain()
    R, t = chain.camera_poses([0.0])
    np.testing.assert_allclose(t, [0, 0, 1.3], atol=1e-12)
    np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-12)
    assert mount.name == "arm"
    assert mount.home == (0.2,)
    # the flap is fixed at its angle, the wheel stays when the body heaves
    loose = mount.chain(with_suspension=True)
    R, t = loose.link_poses([0.1, 0, 0, 0.0])
    lid, wheel = loose.link_names.index("lid"), loose.link_names.index("wheel")
    np.testing.assert_allclose(t[wheel], [0, 0.2, 0.4], atol=1e-12)
    np.testing.assert_allclose(t[lid], [0, 0.3, 1.4], atol=1e-12)
    np.testing.assert_allclose(R[lid][2], [0, math.sin(0.5), math.cos(0.5)], atol=1e-12)
    masses = {name: link.mass for name, link in UrdfModel.from_file(mount.urdf).links.items()}
    assert min(masses.values()) > 0


def test_wrong_names_in_a_wrapped_urdf_are_told_at_once(arm):
    with pytest.raises(
        ValueError, match=r"arm.urdf has no moving joint 'knee'; it has \['tilt', 'axle'"
    ):
        mount_from_urdf(arm, ["knee"], "eye", [0.0])
    with pytest.raises(ValueError, match="no link 'nose' for the camera"):
        mount_from_urdf(arm, ["tilt"], "nose", [0.0])
    with pytest.raises(ValueError, match="no wheel 'skid'"):
        mount_from_urdf(arm, ["tilt"], "eye", [0.0], wheels=["skid"])
    with pytest.raises(ValueError, match="'tilt' at 2 is outside"):
        mount_from_urdf(arm, ["tilt"], "eye", [2.0])
    with pytest.raises(FileNotFoundError, match="no URDF at"):
        mount_from_urdf(arm.parent / "leg.urdf", ["tilt"], "eye", [0.0])
    text = arm.read_text().replace('<sphere radius="0.1"/>', '<mesh filename="package://a/b.stl"/>')
    arm.write_text(text)
    with pytest.raises(FileNotFoundError, match=r"b.stl, which is in none of.*package_dirs"):
        mount_from_urdf(arm, ["tilt"], "eye", [0.0])


def test_the_same_urdf_is_written_once_by_many_at_the_same_time(arm, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))

    def write(_):
        return write_urdf_cached(load_urdf_xml(arm), "arm")

    with ThreadPoolExecutor(8) as pool:
        paths = set(pool.map(write, range(32)))
    assert len(paths) == 1
    folder = paths.pop().parent
    assert len(list(folder.iterdir())) == 1
    assert folder.stat().st_mode & 0o077 == 0


@pytest.mark.parametrize(
    "rpy", [(0.3, -0.4, 2.0), (0.1, math.pi / 2, 0.7), (-0.2, -math.pi / 2, 0)]
)
def test_origins_survive_being_written(rpy):
    T = transform_from_xyz_rpy((1, 2, 3), rpy)
    joint = ET.Element("joint")
    write_origin(joint, T)
    np.testing.assert_allclose(read_origin(joint), T, atol=1e-9)


def test_unknown_mounts_are_answered_by_the_choices():
    with pytest.raises(ValueError, match="unknown mount 'crane'; choose from mast, husky_panda"):
        make_mount("crane")


def test_a_mount_stays_as_it_is_and_checks_its_lengths():
    mount = make_mount("mast")
    assert make_mount(mount) is mount
    assert len(mount.encoder_noise) == len(mount.alpha) == 5
    with pytest.raises(ValueError, match=r"Mount.home needs one value for each"):
        dataclasses.replace(mount, home=(0.0,))
    with pytest.raises(ValueError, match=r"Mount.encoder_noise must be finite and >= 0"):
        dataclasses.replace(mount, encoder_noise=-1.0)
    with pytest.raises(ValueError, match="has no suspension"):
        dataclasses.replace(mount, suspension=None).chain(with_suspension=True)
    with pytest.raises(ValueError, match="'elbow' at 0 is outside of its limits"):
        dataclasses.replace(mount, home=(0.0,) * 5).chain()


def test_suspensions_need_stiffness():
    with pytest.raises(ValueError, match=r"Suspension.roll_stiffness must be .* > 0, got 0"):
        Suspension(roll_stiffness=0)
    with pytest.raises(
        ValueError, match=r"Suspension.heave_damping must be a finite number >= 0, got -1"
    ):
        Suspension(heave_damping=-1)


def test_missing_packages_are_named_with_their_pip_command(monkeypatch):
    def missing(name):
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "files", missing)
    with pytest.raises(ImportError, match=r"example-robot-data.*pip install 'coopmap\[mounts\]'"):
        make_mount("tiago")
    real = builtins.__import__

    def without(name, *args, **kwargs):
        if name.startswith("pybullet_data"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr("importlib.import_module", without)
    with pytest.raises(ImportError, match=r"pybullet_data.*pip install 'coopmap\[field\]'"):
        make_mount("husky_panda")


def _dense(triangles, spacing):
    """Points (m, 3) on triangles, no farther apart than about `spacing`."""
    parts = [triangles.reshape(-1, 3)]
    if len(triangles):
        edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1)
        for triangle in triangles[edges > spacing]:
            n = int(np.linalg.norm(np.ptp(triangle, axis=0)) / spacing) + 1
            a, b = np.mgrid[0 : n + 1, 0 : n + 1].reshape(2, -1) / n
            inside = a + b <= 1 + 1e-9
            a, b = a[inside, None], b[inside, None]
            parts.append(
                triangle[0] + a * (triangle[1] - triangle[0]) + b * (triangle[2] - triangle[0])
            )
    return np.concatenate(parts)
