"""What the reader of URDFs takes, and what it says about files that are broken."""

import re

import numpy as np
import pytest

from coopmap_env.core.files import FileError
from coopmap_env.robots import Chain, UrdfError, UrdfModel

INERTIA = '<inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/>'
LIMIT = '<limit lower="-1" upper="1" effort="10" velocity="1"/>'


def joint(name, parent, child, kind="revolute", inside=LIMIT):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f"{inside}</joint>"
    )


def robot(*elements):
    return f'<robot name="r">{"".join(elements)}</robot>'


def arm(inside=LIMIT, kind="revolute", link=""):
    """Two links, joined by "tilt"."""
    parts = '<link name="a"/>', f'<link name="b">{link}</link>'
    return robot(*parts, joint("tilt", "a", "b", kind, inside))


def visual(geometry, origin=""):
    return f"<visual>{origin}<geometry>{geometry}</geometry></visual>"


@pytest.fixture
def read(tmp_path):
    """Reads a URDF given as text."""

    def read_text(text):
        path = tmp_path / "arm.urdf"
        path.write_text(text)
        return UrdfModel.from_file(path)

    return read_text


@pytest.mark.parametrize(
    ("limit", "lower", "upper"),
    [
        ('lower="-0.7" upper="0.2"', -0.7, 0.2),
        ('lower="-0.7"', -0.7, 0.0),
        ('upper="2.5"', 0.0, 2.5),
        ('lower="-1e+16" upper="1e+16"', -np.inf, np.inf),  # as Gazebo writes none
    ],
)
def test_a_missing_limit_is_zero(read, limit, lower, upper):
    (tilt,) = read(arm(f'<limit {limit} effort="1" velocity="1"/>')).joints
    assert (tilt.lower, tilt.upper) == (lower, upper)


@pytest.mark.parametrize(
    ("kind", "limit", "value"),
    [
        ("revolute", 'lower="0.3" upper="0.3"', 0.3),
        ("prismatic", 'lower="-0.2" upper="-0.2"', -0.2),
        ("revolute", "", 0.0),
        ("revolute", 'upper="0"', 0.0),
    ],
)
def test_equal_limits_make_a_fixed_joint_at_that_value(read, kind, limit, value):
    inside = f'<origin xyz="1 0 0"/><axis xyz="0 0 1"/><limit {limit} effort="1" velocity="1"/>'
    model = read(arm(inside, kind))
    T = np.eye(4)
    T[0, 3] = 1.0
    if kind == "prismatic":
        T[2, 3] = value
    else:
        T[:2, :2] = [[np.cos(value), -np.sin(value)], [np.sin(value), np.cos(value)]]
    np.testing.assert_allclose(model.link_poses()["b"], T, atol=1e-15)
    assert model.joints[0].joint_type == "fixed"
    assert model.joint_values() == {"tilt": value}
    reason = rf"arm.urdf has no moving joint 'tilt' \(equal limits, .* hold it at {value:g}\)"
    with pytest.raises(ValueError, match=reason):
        Chain.from_urdf(model.path, ["tilt"], "b")


def test_a_continuous_joint_needs_no_limit_and_has_none(read):
    for inside in ("", LIMIT):
        (tilt,) = read(arm(inside, "continuous")).joints
        assert (tilt.lower, tilt.upper) == (-np.inf, np.inf)


def test_axes_are_brought_to_length_one_and_are_along_x_by_default(read):
    (tilt,) = read(arm(LIMIT + '<axis xyz="0 -3 4"/>')).joints
    np.testing.assert_allclose(tilt.axis, [0, -0.6, 0.8], atol=1e-15)
    np.testing.assert_array_equal(read(arm()).joints[0].axis, [1, 0, 0])
    # the axis of a joint that does not move says nothing
    read(arm('<axis xyz="0 0 0"/>', "fixed"))


def test_rotations_are_fixed_axis_angles_or_quaternions(read):
    quarter = 'rpy="0 0 1.5707963267948966"'
    half = np.sqrt(0.5)
    for rotation in (quarter, f'quat_xyzw="0 0 {half} {half}"', 'quat_xyzw="0 0 2 2"'):
        model = read(arm(f'<origin xyz="1 2 3" {rotation}/>{LIMIT}'))
        expected = [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
        np.testing.assert_allclose(model.link_poses()["b"], expected, atol=1e-15)


def test_the_inertia_is_turned_into_the_axes_of_the_link(read):
    origin = '<origin xyz="0 0 0.5" rpy="0 0 1.5707963267948966"/>'
    link = read(arm(link=f'<inertial>{origin}<mass value="4"/>{INERTIA}</inertial>')).links["b"]
    assert link.mass == 4
    np.testing.assert_array_equal(link.center_of_mass, [0, 0, 0.5])
    np.testing.assert_allclose(link.inertia, np.diag([2, 1, 3]), atol=1e-15)
    assert read(arm(link='<inertial><mass value="0"/></inertial>')).links["b"].mass == 0
    assert read(arm()).links["b"].mass == 0


def test_visual_shapes_are_read_else_collision_shapes(read):
    pytest.importorskip("trimesh")
    collision = '<collision><geometry><box size="2 2 2"/></geometry></collision>'
    both = read(arm(link=visual('<box size="4 4 4"/>') + collision))
    assert np.abs(both.triangles("b")).max() == 2
    assert np.abs(read(arm(link=collision)).triangles("b")).max() == 1
    assert both.triangles("a").shape == (0, 3, 3)


@pytest.mark.parametrize(
    ("geometry", "bounds", "area"),
    [
        ('<box size="1 2 3"/>', (0.5, 1, 1.5), 22.0),
        ('<cylinder radius="0.5" length="2"/>', (0.5, 0.5, 1), 2.5 * np.pi),
        ('<sphere radius="0.5"/>', (0.5, 0.5, 0.5), np.pi),
        # a cylinder of length 2 between two half spheres
        ('<capsule radius="0.5" length="2"/>', (0.5, 0.5, 1.5), 3 * np.pi),
        ('<capsule radius="0.5" length="0"/>', (0.5, 0.5, 0.5), np.pi),
        ('<box size="1 2 0"/>', (0.5, 1, 0), 4.0),  # a plate without thickness, both its sides
    ],
)
def test_shapes_have_their_size_and_area(read, geometry, bounds, area):
    pytest.importorskip("trimesh")
    triangles = read(arm(link=visual(geometry))).triangles("b")
    points = triangles.reshape(-1, 3)
    np.testing.assert_allclose(points.max(axis=0), bounds, rtol=0.01)
    np.testing.assert_allclose(points.min(axis=0), -np.array(bounds), rtol=0.01)
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    areas = np.linalg.norm(np.cross(a, b), axis=1) / 2
    assert areas.sum() == pytest.approx(area, rel=0.02)
    assert areas.min() > 0


@pytest.mark.parametrize(
    "geometry",
    [
        '<box size="0 0 0"/>', '<box size="1 0 0"/>', '<sphere radius="0.0"/>',
        '<cylinder radius="0" length="1"/>', '<capsule radius="0" length="1"/>',
        '<mesh filename="a.stl" scale="0"/>',
    ],
)  # fmt: skip
def test_shapes_without_area_are_left_out(read, geometry):
    pytest.importorskip("trimesh")
    link = visual(geometry) + f"<collision><geometry>{geometry}</geometry></collision>"
    model = read(arm(link=link))
    assert model.triangles("b").shape == (0, 3, 3)
    with_box = read(arm(link=link + visual('<box size="1 1 1"/>')))
    assert with_box.triangles("b").shape == (12, 3, 3)


def test_comments_materials_and_elements_of_other_programs_are_passed_over(read):
    geometry = "<!-- round --><sphere radius='1'/><material name='red'/>"
    link = visual(geometry) + "<material name='${no}'><color rgba='1 0 0'/></material>"
    with pytest.raises(UrdfError, match="run xacro first"):
        read(arm(link=link))
    text = arm(link=link.replace("${no}", "no")).replace(
        "</robot>", "<gazebo><plugin name='${a}'/></gazebo><transmission name='t'/></robot>"
    )
    assert list(read(text).links) == ["a", "b"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        # joints
        (arm(""), r"joint 'tilt': its <limit> is missing, which a revolute joint needs"),
        (arm("", "prismatic"), r"joint 'tilt': its <limit> is missing, which a prismatic joint"),
        (arm('<limit lower="1" upper="-1"/>'), r"'tilt', <limit>: lower=1 is above upper=-1"),
        (arm('<limit lower="nan" upper="1"/>'), r"'tilt', <limit>: lower='nan', expected a number"),
        (arm('<limit lower="0,5" upper="1"/>'), r"<limit>: lower='0,5', .*commas cannot stand"),
        (arm('<limit lower="1e999" upper="1"/>'), r"<limit>: lower='1e999' is not finite"),
        (arm(LIMIT + '<axis xyz="0 0 0"/>'), r"'tilt', <axis>: xyz='0 0 0' has no direction"),
        (arm(LIMIT + '<axis xyz="0 nan 0"/>'), r"'tilt', <axis>: xyz='0 nan 0', expected 3 num"),
        (arm(LIMIT + '<axis xyz="0 1"/>'), r"'tilt', <axis>: xyz='0 1', expected 3 numbers"),
        (arm(LIMIT + '<axis xyz="0, 0, 1"/>'), r"<axis>: xyz='0, 0, 1', .*commas cannot stand"),
        (arm(LIMIT + '<axis xyz=""/>'), r"'tilt', <axis>: its xyz is missing"),
        (arm(LIMIT + '<origin rpy="0 0 1_0"/>'), r"<origin>: rpy='0 0 1_0', expected 3 numbers"),
        (arm(LIMIT + '<origin xyz="0 0 1e300"/>'), r"<origin>: xyz='0 0 1e300' is larger than"),
        (arm(LIMIT + '<origin quat_xyzw="0 0 0 0"/>'), r"quat_xyzw='0 0 0 0' is no rotation"),
        (arm(LIMIT + '<origin quat_xyzw="0 0 0 1e200"/>'), r"quat_xyzw='0 0 0 1e200' is larger"),
        (arm(LIMIT + '<origin/><origin xyz="1 0 0"/>'), r"it has 2 elements <origin>, exp"),
        (arm(LIMIT + '<dynamics damping="x"/>'), r"<dynamics>: damping='x', expected a number"),
        (arm(LIMIT + '<mimic multiplier="2"/>'), r"'tilt', <mimic>: its joint is missing"),
        (arm(LIMIT, "hinge"), r"joint 'tilt': type='hinge', expected one of \['revolute'"),
        (arm(LIMIT, ""), r"joint 'tilt': its type is missing"),
        (arm().replace('name="tilt"', ""), r"joint number 1: its name is missing"),
        (arm().replace('<parent link="a"/>', ""), r"joint 'tilt': its <parent> is missing"),
        (arm().replace('<child link="b"/>', "<child/>"), r"'tilt', <child>: its link is missing"),
        # links
        (robot(), r"has 0 root links"),
        (robot('<link name="a"/>', '<link name="b"/>'), r"has 2 root links \['a', 'b'\]"),
        (robot('<link name="a"/>', '<link name="a"/>'), r"link 'a': there are two links of this"),
        (arm().replace("</robot>", joint("tilt", "a", "c") + '<link name="c"/></robot>'),
         r"joint 'tilt': there are two joints of this name"),
        (arm().replace("</robot>", joint("x", "a", "b") + "</robot>"),
         r"link 'b' is the child of two joints, 'tilt' and 'x'"),
        (arm().replace('<parent link="a"/>', '<parent link="z"/>'),
         r"joint 'tilt': no link 'z', which is its parent"),
        (arm().replace("</robot>", '<link name="c"/><link name="d"/>' + joint("x", "c", "d")
                       + joint("y", "d", "c") + "</robot>"), r"\['x', 'y'\] form a circle"),
        (robot('<link name="' + "n" * 300 + '"/>'), r"has 300 characters, expected 255 at most"),
        # masses
        (arm(link=f'<inertial><mass value="-1"/>{INERTIA}</inertial>'),
         r"link 'b', <inertial>, <mass>: value=-1, expected a number >= 0"),
        (arm(link=f'<inertial><mass value="nan"/>{INERTIA}</inertial>'), r"<mass>: value='nan'"),
        (arm(link=f"<inertial>{INERTIA}</inertial>"), r"'b', <inertial>: its <mass> is missing"),
        (arm(link='<inertial><mass value="1"/></inertial>'), r"a mass, but no <inertia>"),
        (arm(link=f'<inertial><mass value="1"/>{INERTIA.replace("ixx", "x")}</inertial>'),
         r"link 'b', <inertial>, <inertia>: its ixx is missing"),
        (arm(link=f'<inertial><mass value="1"/>{INERTIA.replace("3", "-3")}</inertial>'),
         r"<inertia>: izz=-3, expected a number >= 0"),
        (arm(link=f'<inertial><mass value="1"/>{INERTIA.replace("3", "NaN")}</inertial>'),
         r"<inertia>: izz='NaN', expected a number"),
        # shapes
        (arm(link="<visual/>"), r"link 'b', <visual>: its <geometry> is missing"),
        (arm(link=visual("")), r"<geometry>: expected one of \['box', 'cylinder'.*, not \[\]"),
        (arm(link=visual("<plane/>")), r"<geometry>: expected one of .*, not \['plane'\]"),
        (arm(link=visual('<box size="1 1"/>')), r"<box>: size='1 1', expected 3 numbers"),
        (arm(link=visual('<box size="1,1,1"/>')), r"<box>: size='1,1,1', .*commas cannot stand"),
        (arm(link=visual('<box size="1 1 -1"/>')), r"<box>: size='1 1 -1', expected numbers >= 0"),
        (arm(link=visual('<sphere radius="-1"/>')), r"<sphere>: radius=-1, expected a number >= 0"),
        (arm(link=visual('<cylinder radius="1"/>')), r"<cylinder>: its length is missing"),
        (arm(link=visual("<mesh/>")), r"<mesh>: its filename is missing"),
        # not a URDF, or not yet one
        ('<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:box/></robot>',
         r"xacro:?.*box> belongs to xacro: run xacro first"),
        (arm('<limit lower="${-pi}" upper="1"/>'), r"<limit> belongs to xacro \(lower=.*run xacro"),
        (arm(LIMIT + '<origin xyz="$(arg x) 0 0"/>'), r"<origin> belongs to xacro .*run xacro fir"),
        ("<sdf/>", r"expected the element <robot>, not <sdf>"),
        ("<robot>" + "<link>" * 9 + "</robot>", r"line 1, column \d+: expected XML: mismatched"),
        ("", r"line 1, column 0: expected XML: no element found"),
        (robot('<link name="a">' + "<x>" * 60 + "</x>" * 60 + "</link>"), r"over 50 elements are"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_with_the_file_and_the_element(read, text, message):
    with pytest.raises(UrdfError, match=message) as caught:
        read(text)
    assert re.match(r"\S*arm\.urdf\b", str(caught.value))
    assert len(str(caught.value)) < 700
    assert isinstance(caught.value, ValueError | FileError)


def test_a_truncated_urdf_is_no_smaller_model(read, tmp_path):
    boxes = "".join(visual(f'<box size="{n} 1 1"/>') for n in range(1, 5))
    text = arm(link=boxes)
    assert len(read(text).links["b"].visuals) == 4
    for length in range(len(text)):
        with pytest.raises(UrdfError, match=r"arm.urdf, line 1, column \d+: expected XML"):
            read(text[:length])


def test_joints_that_are_no_angle_or_length_are_told_by_name_where_a_mount_needs_one(read):
    for kind in ("planar", "floating", "spherical"):
        links = "".join(f'<link name="{name}"/>' for name in "abc")
        model = read(robot(links, joint("tilt", "a", "b"), joint("world", "b", "c", kind, "")))
        np.testing.assert_array_equal(model.link_poses()["c"], np.eye(4))
        with pytest.raises(ValueError, match=rf"arm.urdf: the joint 'world' is {kind}"):
            Chain.from_urdf(model.path, ["tilt"], "b")


def test_a_long_chain_is_read_in_time_that_grows_with_it_and_refused_as_a_mount(read):
    n = 2000  # a reader whose cost grows with the square would take minutes
    links = "".join(f'<link name="l{i}"/>' for i in range(n))
    joints = [joint("j0", "l0", "l1")]
    joints += [
        joint(f"j{i}", f"l{i}", f"l{i + 1}", inside=f'{LIMIT}<mimic joint="j{i - 1}"/>')
        for i in range(1, n - 1)
    ]
    joints = "".join(reversed(joints))
    model = read(robot(links, joints))
    assert len(model.links) == n
    assert {j.mimic.joint for j in model.joints if j.mimic} == {"j0"}
    with pytest.raises(UrdfError, match=r"arm.urdf has 2000 links .*a mount can have 128"):
        Chain.from_urdf(model.path, ["j0"], "l1")
