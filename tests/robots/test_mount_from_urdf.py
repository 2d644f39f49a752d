"""Mounts from other URDFs: their names, wheels, suspension and fixed joints."""

import math

import numpy as np
import pytest

from coopmap_env.robots import Mount, mount_from_urdf


@pytest.mark.parametrize(
    "name",
    ["left/arm", "left\\arm", "n" * 300, "\u00e9" * 60, "", "  ", "a\nb", "a\0b", "\udc80", 3],
)
def test_the_name_of_a_mount_can_name_a_file(arm, name):
    with pytest.raises(ValueError, match=r"Mount\.name "):
        Mount(name, arm, "eye", ("tilt",), (0.0,))
    if name != "":  # there it is the URDF's
        with pytest.raises(ValueError, match=r"Mount\.name "):
            mount_from_urdf(arm, ["tilt"], "eye", [0.0], name=name)


def test_a_long_name_of_a_urdf_needs_another_name_for_the_mount(arm):
    long = arm.rename(arm.with_name("n" * 200 + ".urdf"))
    with pytest.raises(ValueError, match=r"Mount\.name must have at most 100 bytes, got 200"):
        mount_from_urdf(long, ["tilt"], "eye", [0.0])
    for name in ("short", "left arm \u00e9 (1)", "n" * 100):
        assert mount_from_urdf(long, ["tilt"], "eye", [0.0], name=name).urdf.is_file()


def test_names_are_given_in_a_sequence_and_numbers_as_numbers(arm):
    with pytest.raises(ValueError, match=r"Mount\.joints must be a sequence of names, got 'tilt'"):
        Mount("arm", arm, "eye", "tilt", (0.0,))
    with pytest.raises(ValueError, match=r"Mount\.package_dirs must be a sequence of names"):
        Mount("arm", arm, "eye", ("tilt",), (0.0,), package_dirs="meshes")
    with pytest.raises(ValueError, match=r"Mount\.home must be numbers, got \['level'\]"):
        Mount("arm", arm, "eye", ("tilt",), ["level"])


def test_links_below_a_wheel_stay_with_it_and_a_wheel_named_twice_stays(arm):
    text = '<link name="hub"/><joint name="nut" type="fixed"><origin xyz="0 0.1 0"/>'
    text += '<parent link="wheel"/><child link="hub"/></joint></robot>'
    arm.write_text(arm.read_text().replace("</robot>", text))
    for wheels in (["wheel"], ["wheel", "hub"], ["wheel", "wheel"]):
        mount = mount_from_urdf(arm, ["tilt"], "eye", [0.0], root_height=0.3, wheels=wheels)
        chain = mount.chain(with_suspension=True)
        _, t = chain.link_poses([0.1, 0.05, 0.05, 0.0])
        np.testing.assert_allclose(t[chain.link_names.index("wheel")], [0, 0.2, 0.4], atol=1e-12)
        np.testing.assert_allclose(t[chain.link_names.index("hub")], [0, 0.3, 0.4], atol=1e-12)
    with pytest.raises(ValueError, match="the joint 'tilt' moves the wheel 'lid'"):
        mount_from_urdf(arm, ["tilt"], "eye", [0.0], wheels=["lid"])
    with pytest.raises(ValueError, match="no wheel 'stand' below the root"):
        mount_from_urdf(arm, ["tilt"], "eye", [0.0], wheels=["stand"])


def test_a_mount_on_a_suspension_gets_no_second_one(arm):
    mount = mount_from_urdf(arm, ["tilt"], "eye", [0.0])
    with pytest.raises(ValueError, match=r"the URDF has \['suspension_body', .*'suspension_heave'"):
        mount_from_urdf(mount.urdf, ["tilt"], "eye", [0.0])


def test_a_joint_of_a_mount_with_equal_limits_is_fixed(arm):
    """In the kinematics as in the file that physics loads."""
    limits = 'lower="-1" upper="1"', 'lower="0.4" upper="0.4"'
    arm.write_text(limits[1].join(arm.read_text().rsplit(limits[0], 1)))  # those of the flap
    with pytest.raises(ValueError, match=r"no moving joint 'flap' \(equal limits.* at 0\.4\)"):
        mount_from_urdf(arm, ["flap"], "eye", [0.4])
    chain = mount_from_urdf(arm, ["tilt"], "eye", [0.0]).chain()
    R, _ = chain.link_poses([0.0])
    lid = chain.link_names.index("lid")
    np.testing.assert_allclose(R[lid][2], [0, math.sin(0.4), math.cos(0.4)], atol=1e-12)
