"""The mounts that come with the package, and mounts from any other URDF."""

from __future__ import annotations

import importlib.metadata
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from coopmap_env.core.choices import unknown
from coopmap_env.core.extras import import_optional
from coopmap_env.core.files import brief
from coopmap_env.core.settings import checked_value
from coopmap_env.geometry import Pose
from coopmap_env.robots.kinematics import urdf_editing
from coopmap_env.robots.kinematics.chain import check_link_count, check_names
from coopmap_env.robots.kinematics.urdf_loading import load_urdf_xml, write_urdf_cached
from coopmap_env.robots.kinematics.urdf_xml import transform_from_xyz_rpy
from coopmap_env.robots.mount import DEGREE, Mount, as_names, check_mount_name, check_suspension
from coopmap_env.robots.suspension import Suspension

MODEL_DIR = Path(__file__).parent / "models"

_SIDES = ("left", "right")

R_OPTICAL_CAMERA = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
"""R_optical_camera: from x forward, y left, z up to an optical frame's z forward, y down."""


def mount_from_urdf(
    urdf: str | Path,
    joints: Sequence[str],
    camera_link: str,
    home: Sequence[float] | None = None,
    *,
    name: str = "",
    suspension: Suspension | None = None,
    root_height: float = 0.0,
    wheels: Sequence[str] = (),
    fixed_joints: Mapping[str, float] | None = None,
    package_dirs: Sequence[str] = (),
    **settings: Any,
) -> Mount:
    """A mount from any URDF: its root is put on a suspension, other joints are fixed.

    Meshes are in metres unless their format names a unit. A ``package://name/...`` is searched in
    the URDF's folder, in `package_dirs`, and in folders above that have the name or a package.xml
    with it.

    Parameters
    ----------
    urdf : path
    joints : sequence of str
        The joints that move the camera.
    camera_link : str
    home : sequence of float, optional
        Joint values at the start; by default 0, or the limit that is nearest to it.
    name : str, optional
        The URDF's file name, if not given.
    suspension : Suspension, optional
        Choose the stiffness for the mass: the default is one for 150 kg.
    root_height : float, optional
        Of the URDF's root link above ground, metres.
    wheels : sequence of str, optional
        Links that stay on the ground while the body heaves, rolls and pitches.
    fixed_joints : mapping of str to float, optional
        Values of joints that are not to move, such as a folded arm; 0 if not given. Joints that
        mimic others follow them, whether those move or are fixed.
    package_dirs : sequence of str, optional
        Folders in which ``package://`` meshes are searched.
    **settings
        Other fields of `Mount`: `T_link_camera`, `encoder_noise`, `calibration_error`, `alpha`.

    Raises
    ------
    FileNotFoundError
        If the URDF or a mesh is not there.
    UrdfError
        A ValueError, if the URDF or a mesh cannot be read; the message names file and element.
    ValueError
        If a joint or link does not exist, or a joint does not move by itself; the message lists
        those that do. If the name cannot name a file.
    """
    name = name or Path(urdf).stem
    check_mount_name(name)
    joints = as_names("joints", joints)
    package_dirs = as_names("package_dirs", package_dirs)
    if not isinstance(fixed_joints or {}, Mapping):
        raise ValueError(f"fixed_joints must map names to values, got {brief(fixed_joints)}")
    root_height = checked_value("root_height", root_height, float)
    tree = load_urdf_xml(urdf, package_dirs)
    return _suspended_mount(
        tree, Path(urdf), name, joints, camera_link, home,
        Suspension() if suspension is None else suspension, root_height,
        as_names("wheels", wheels), fixed_joints or {}, settings,
    )  # fmt: skip


def _suspended_mount(
    tree: Any,
    path: Path,
    name: str,
    joints: Sequence[str],
    camera_link: str,
    home: Sequence[float] | None,
    suspension: Suspension,
    root_height: float,
    wheels: Sequence[str],
    fixed_joints: Mapping[str, float],
    settings: Mapping[str, Any],
) -> Mount:
    check_names(joints, camera_link, [link.get("name", "") for link in tree.iter("link")], path)
    urdf_editing.fix_joints(tree, joints, fixed_joints, path)
    check_suspension(suspension)
    urdf_editing.add_suspension(tree, suspension.roll_center_height, root_height, wheels)
    check_link_count(len(tree.findall("link")), path)
    mount = Mount(
        name=name,
        urdf=write_urdf_cached(tree, name),
        camera_link=camera_link,
        joints=tuple(joints),
        home=(0.0,) * len(joints) if home is None else tuple(home),
        suspension=suspension,
        **settings,
    )
    try:
        if home is None:
            chain = mount.chain(with_suspension=True)  # with it, home is not checked
            lower, upper = (limits[-len(joints) :] for limits in (chain.lower, chain.upper))
            mount = replace(mount, home=tuple(np.clip(0.0, lower, upper).tolist()))
        mount.chain()  # a wrong name or value raises here, not at the first use
    except ValueError as error:  # it names the file that was written, which the user does not know
        raise type(error)(str(error).replace(str(mount.urdf), str(path))) from error
    return mount


def mast() -> Mount:
    """A chassis of 120 kg with a mast of 25 kg: turntable, shoulder, elbow, wrist pan and tilt."""
    return Mount(
        name="mast",
        urdf=MODEL_DIR / "mast.urdf",
        camera_link="camera",
        joints=("turntable", "shoulder", "elbow", "wrist_pan", "wrist_tilt"),
        home=(0.0, -0.8, 1.8, 0.0, 0.0),
        suspension=Suspension(),
    )


def husky_panda() -> Mount:
    """Clearpath's Husky carrying Franka's Panda, the camera beside its gripper.

    From the files of pybullet_data. The camera faces along the hand's approach axis and sits where
    a wrist camera is screwed on, so that the fingers are out of its view.
    """
    data = Path(import_optional("pybullet_data", "field").getDataPath())
    tree = load_urdf_xml(
        data / "husky" / "husky.urdf",
        without_links=["imu_link"],  # an expression of xacro is left in its pose
    )
    panda = load_urdf_xml(data / "franka_panda" / "panda.urdf")
    urdf_editing.attach_tree(tree, panda, "base_link", transform_from_xyz_rpy((0.05, 0.0, 0.224)))
    R = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    R[:, 1] *= -1.0  # camera x along the hand's z, camera z along the hand's x
    return _suspended_mount(
        tree, data, "husky_panda", tuple(f"panda_joint{i}" for i in range(1, 8)), "panda_hand",
        (0.0, -0.6, 0.0, -2.2, 0.0, 3.0, math.pi / 4), _HUSKY_SUSPENSION, 0.0,
        tuple(f"{end}_{side}_wheel_link" for end in ("front", "rear") for side in _SIDES),
        {}, {"T_link_camera": Pose(np.array([0.07, 0.0, 0.04]), R)},
    )  # fmt: skip


_HUSKY_SUSPENSION = Suspension(
    heave_stiffness=20_000.0,
    roll_stiffness=5_000.0,
    pitch_stiffness=6_500.0,
    heave_damping=1_450.0,
    roll_damping=300.0,
    pitch_damping=390.0,
    roll_center_height=0.18,
)
"""As the mast's, for a third of the mass: 0.7 of the critical damping."""


def tiago() -> Mount:
    """PAL's TIAGo with its arm folded: torso lift, head pan, head tilt, camera in the head."""
    urdf = _example_robot_data("tiago_description/robots/tiago_no_hand.urdf")
    arm = dict(zip(range(1, 8), (0.2, -1.34, -0.2, 1.94, -1.57, 1.37, 0.0), strict=True))
    casters = [f"caster_{end}_{side}_1_link" for end in ("front", "back") for side in _SIDES]
    return mount_from_urdf(
        urdf,
        ("torso_lift_joint", "head_1_joint", "head_2_joint"),
        "xtion_optical_frame",
        (0.15, 0.0, -0.2),
        name="tiago",
        suspension=_TIAGO_SUSPENSION,
        wheels=[*(f"wheel_{side}_link" for side in _SIDES), *casters],
        fixed_joints={f"arm_{i}_joint": value for i, value in arm.items()},
        package_dirs=[str(urdf.parents[3]), str(urdf.parents[4])],
        # 3 cm in front of the link, whose origin lies inside the shell of the head
        T_link_camera=Pose(np.array([0.0, 0.0, 0.03]), R_OPTICAL_CAMERA),
        encoder_noise=(0.001, 0.1 * DEGREE, 0.1 * DEGREE),
        calibration_error=(0.002, 0.15 * DEGREE, 0.15 * DEGREE),
        # its whole lift of 0.35 m is as far as a turn of the head by 1.75 rad
        alpha=(25.0, 1.0, 1.0),
    )


_TIAGO_SUSPENSION = Suspension(
    heave_stiffness=28_000.0,
    roll_stiffness=2_000.0,
    pitch_stiffness=2_500.0,
    heave_damping=2_000.0,
    roll_damping=300.0,
    pitch_damping=330.0,
    roll_center_height=0.1,
    heave_std=0.0002,
    roll_std=0.0002,
    pitch_std=0.00015,
)
"""Softer in roll and pitch, a narrow base; its lift and light head move it little."""


def _example_robot_data(relative_path: str) -> Path:
    """A file of the example-robot-data package, which is no Python module."""
    try:
        files = importlib.metadata.files("example-robot-data") or []
    except importlib.metadata.PackageNotFoundError as error:
        raise ImportError(
            "example-robot-data is needed here and is not installed: pip install 'coopmap[mounts]'"
        ) from error
    for file in files:
        if file.as_posix().endswith(relative_path):
            return Path(str(file.locate()))
    raise FileNotFoundError(f"example-robot-data is installed, but has no file {relative_path}")


MOUNTS: dict[str, Callable[[], Mount]] = {
    "mast": mast,
    "husky_panda": husky_panda,
    "tiago": tiago,
}
"""Makers of the mounts, by name."""


def make_mount(mount: str | Mount) -> Mount:
    """A mount by its name; a `Mount` is returned unchanged.

    Raises
    ------
    ValueError
        If there is no mount of that name; the message lists the choices.
    ImportError
        If the mount needs a package that is not installed; the message says how to install it.
    """
    if isinstance(mount, Mount):
        return mount
    if not isinstance(mount, str) or mount not in MOUNTS:
        if str(mount).endswith((".urdf", ".xacro", ".xml")):
            raise ValueError(
                f"a URDF alone does not say what moves and where the camera is: give mount="
                f"coopmap.mount_from_urdf({str(mount)!r}, joints=[...], camera_link=...), or on "
                "the command line --joints and --camera-link"
            )
        raise ValueError(f"{unknown('mount', mount, MOUNTS)}, or give a Mount")
    return MOUNTS[mount]()
