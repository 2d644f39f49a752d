"""Broken URDFs: each is read, or refused by the one error that names the file."""

from pathlib import Path

import numpy as np
from plain.fuzz import cases, mutants, read_or_refuse

from coopmap_env.robots import Mount, UrdfError, UrdfModel, mount_from_urdf

ARM = b"""<?xml version="1.0"?>
<robot name="arm" version="1.1">
  <link name="stand"><inertial><origin xyz="0 0 0.1" rpy="0 0 0.2"/><mass value="20"/>
    <inertia ixx="1" ixy="0" ixz="0" iyy="1.5" iyz="0" izz="2"/></inertial>
    <visual><geometry><box size="0.6 0.4 0.2"/></geometry></visual>
    <collision><geometry><cylinder radius="0.3" length="0.2"/></geometry></collision></link>
  <joint name="tilt" type="revolute"><origin xyz="0 0 1" rpy="0 0 1.57"/>
    <parent link="stand"/><child link="eye"/><axis xyz="0 1 0"/>
    <dynamics damping="0.1" friction="0.2"/>
    <limit lower="-1" upper="1" effort="100" velocity="1"/></joint>
  <link name="eye"><visual><geometry><sphere radius="0.1"/></geometry></visual></link>
  <joint name="level" type="revolute"><origin xyz="0.3 0 0" quat_xyzw="0 0 0 1"/>
    <parent link="eye"/><child link="lid"/><axis xyz="1 0 0"/>
    <limit lower="-2" effort="1" velocity="1"/><mimic joint="tilt" multiplier="-1" offset="0.1"/>
  </joint>
  <link name="lid"><collision><geometry><capsule radius="0.1" length="0.2"/></geometry></collision>
  </link>
  <joint name="slide" type="prismatic"><parent link="lid"/><child link="hook"/>
    <limit lower="0" upper="0.2" effort="1" velocity="1"/></joint>
  <link name="hook"/>
</robot>
"""
PLAIN = (
    b'<robot name="p"><link name="stand"/><link name="eye"/><joint name="tilt" type="continuous">'
    b'<parent link="stand"/><child link="eye"/></joint></robot>'
)


@cases(short=2500, long=100_000)
def test_a_broken_urdf_is_read_or_refused_by_name(tmp_path, n_cases):
    path = tmp_path / "arm.urdf"
    n_read = 0
    for content in mutants([ARM, PLAIN], n_cases):
        path.write_bytes(content)
        model = read_or_refuse(UrdfModel.from_file, path, UrdfError)
        if model is None:
            continue
        n_read += 1
        for T in model.link_poses({joint.name: 0.1 for joint in model.joints}).values():
            assert np.isfinite(T).all()
            np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-9)
        for link in model.links.values():
            assert np.isfinite(link.inertia).all()
            assert 0 <= link.mass < np.inf
    assert 0.02 * n_cases < n_read < 0.9 * n_cases


def mount_or_message(path):
    """The mount of a URDF, or None and why there is none."""
    try:
        return mount_from_urdf(path, ["tilt"], "eye", [0.1], fixed_joints={"slide": 0.05}), ""
    except ValueError as error:
        return None, str(error)


@cases(short=250, long=10_000)
def test_a_mount_from_a_broken_urdf_is_made_or_refused_by_name(tmp_path, monkeypatch, n_cases):
    """Links of what is made stand where those of the broken file do."""
    monkeypatch.setattr("tempfile.gettempdir", lambda: str(tmp_path))
    path = tmp_path / "arm.urdf"
    n_made = 0
    for content in mutants([ARM], n_cases, seed=1):
        path.write_bytes(content)
        mount, message = mount_or_message(path)
        if mount is None:
            assert "arm" in message, message
            continue
        n_made += 1
        assert isinstance(mount, Mount)
        R, t = mount.chain().link_poses([0.2])
        assert np.isfinite(R).all()
        assert np.isfinite(t).all()
        assert all(np.isfinite(mesh).all() for mesh in mount.chain().meshes)
        expected = UrdfModel.from_file(path).link_poses({"tilt": 0.2, "slide": 0.05})
        for link, T in expected.items():
            at = mount.chain().link_names.index(link)
            np.testing.assert_allclose(R[at], T[:3, :3], atol=1e-9)
            np.testing.assert_allclose(t[at], T[:3, 3], rtol=1e-9, atol=1e-9)
        Path(mount.urdf).unlink()
    assert n_made > 0.02 * n_cases
