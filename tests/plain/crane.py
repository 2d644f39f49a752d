"""A robot whose equilibrium is known by hand: a mass that slides out on a level beam."""

import numpy as np

from coopmap_env.robots import Mount, Suspension

BODY_MASS, SLIDER_MASS, ROLL_CENTRE_HEIGHT = 80.0, 10.0, 0.3
"""Kilograms; the height of the roll center, in which the body's center of mass and the beam lie."""

LINK = """<link name="{name}"><inertial><mass value="{mass}"/>
<inertia ixx="{i}" iyy="{i}" izz="{i}" ixy="0" ixz="0" iyz="0"/></inertial>{shape}</link>"""
SHAPE = """<collision><geometry><box size="{0} {0} {0}"/></geometry></collision>
<visual><geometry><box size="{0} {0} {0}"/></geometry></visual>"""
JOINT = """<joint name="{name}" type="{kind}"><origin xyz="0 0 {up}"/><parent link="{parent}"/>
<child link="{child}"/><axis xyz="{axis}"/>
<limit lower="{lower}" upper="{upper}" effort="10000" velocity="1"/></joint>"""


def crane(folder, along="1 0 0", roll_axis="1 0 0", suspension=None, **settings):
    """A mount (80 kg on springs) that moves a mass of 10 kg `along` an axis of its body's frame."""
    links = [("base", 1.0, ""), ("heave", 0.001, ""), ("roll", 0.001, "")]
    links += [("body", BODY_MASS, SHAPE.format(0.2)), ("slider", SLIDER_MASS, SHAPE.format(0.1))]
    joints = [
        ("suspension_heave", "prismatic", ROLL_CENTRE_HEIGHT, "0 0 1", -0.1, 0.1),
        ("suspension_roll", "revolute", 0, roll_axis, -0.3, 0.3),
        ("suspension_pitch", "revolute", 0, "0 1 0", -0.3, 0.3),
        ("slide", "prismatic", 0, along, -2.0, 2.0),
    ]
    text = "".join(
        LINK.format(name=name, mass=mass, i=max(1e-6, mass * 0.05), shape=shape)
        for name, mass, shape in links
    )
    for (parent, _, _), (child, _, _), row in zip(links[:-1], links[1:], joints, strict=True):
        name, kind, up, axis, lower, upper = row
        text += JOINT.format(
            name=name, kind=kind, up=up, parent=parent, child=child, axis=axis,
            lower=lower, upper=upper,
        )  # fmt: skip
    path = folder / f"crane-{along.replace(' ', '')}-{roll_axis.replace(' ', '')}.urdf"
    path.write_text(f'<?xml version="1.0"?><robot name="crane">{text}</robot>')
    return Mount(
        name="crane", urdf=path, camera_link="slider", joints=("slide",), home=(0.0,),
        suspension=suspension or Suspension(roll_center_height=ROLL_CENTRE_HEIGHT), **settings,
    )  # fmt: skip


def potential_energy(chain, springs, gravity, s, joints):
    """Of springs and weight, from the poses of all links; minimal in equilibrium."""
    R, t = chain.link_poses(np.concatenate([s, joints]))
    carried = chain.link_body > 0
    at = t[carried] + np.einsum("lij,lj->li", R[carried], chain.centers_of_mass[carried])
    weight = -(chain.masses[carried, None] * at).sum(axis=0) @ gravity
    return 0.5 * (springs.stiffness * s**2).sum() - (springs.preload * s).sum() + weight
