"""Kinematics of a camera mount, read from its URDF."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from coopmap_env.core.kernels import PlainTuple, kernel
from coopmap_env.core.linear_algebra import are_finite, product
from coopmap_env.geometry import Pose
from coopmap_env.robots.kinematics.forward import (
    KinematicTree,
    frame_jacobian,
    frame_poses,
    point_positions,
    rodrigues_terms,
)
from coopmap_env.robots.kinematics.urdf import UrdfModel
from coopmap_env.robots.kinematics.urdf_elements import UrdfJoint
from coopmap_env.robots.kinematics.urdf_xml import UrdfError

MAX_LINKS = 128
"""Links of a mount: PyBullet gives the poses of no more."""
LIMIT_TOLERANCE = 1e-9
"""Radians or metres by which joints may be outside of their limits, by rounding."""


@dataclass(frozen=True, eq=False)
class Chain:
    """A tree of links of which some joints move; a camera is fixed to one link.

    Poses are given in the frame of the root link ("base"). Links that no chosen joint moves
    against each other are one rigid body, so the cost grows with the joints, not with the links.
    """

    joint_names: tuple[str, ...]
    lower: NDArray[np.float64]
    """Shape (n,): lower limits, radians or metres; -inf where there is none."""
    upper: NDArray[np.float64]
    max_speeds: NDArray[np.float64]
    """Shape (n,): radians or metres a second; inf where the URDF states none."""
    is_prismatic: NDArray[np.bool_]
    """Shape (n,): whether a joint is prismatic, so that its value is in metres."""
    link_names: tuple[str, ...]
    masses: NDArray[np.float64]
    """Shape (L,): kilograms."""
    centers_of_mass: NDArray[np.float64]
    """Shape (L, 3), in the links' frames."""
    inertias: NDArray[np.float64]
    """Shape (L, 3, 3): kg m^2 about the centers of mass, along the links' axes."""
    meshes: tuple[NDArray[np.float64], ...]
    """Per link triangles (m, 3, 3) in the link's frame: its visible surface."""
    tree: KinematicTree
    link_body: NDArray[np.int64]
    """Shape (L,): the rigid body that each link belongs to; body 0 does not move."""
    link_rotations: NDArray[np.float64]
    """Shape (L, 3, 3): of the links' frames in their bodies."""
    link_translations: NDArray[np.float64]
    camera_link: int
    T_link_camera: Pose

    @classmethod
    def from_urdf(
        cls,
        urdf: str | Path,
        joints: Sequence[str],
        camera_link: str,
        T_link_camera: Pose | None = None,
        package_dirs: Sequence[str] = (),
        fixed_joints: Mapping[str, float] | None = None,
    ) -> Chain:
        """Read a URDF; joints that are not in `joints` are fixed.

        Parameters
        ----------
        urdf : path
        joints : sequence of str
            The joints that move, in the order of q. For the body on its suspension put the
            `SUSPENSION_JOINTS` first.
        camera_link : str
        T_link_camera : Pose, optional
            Camera frame (x optical axis, y left, z up) in the link's frame.
        package_dirs : sequence of str, optional
            Folders in which ``package://`` meshes are searched.
        fixed_joints : mapping of str to float, optional
            Values of other joints; 0 if not given. Joints that mimic others follow them.

        Raises
        ------
        ImportError
            If the `field` extra is not installed.
        UrdfError
            A ValueError, if the URDF or a mesh cannot be read, or it has over `MAX_LINKS` links.
        ValueError
            If a joint or link does not exist, or a joint does not move by itself; the message
            lists those that do.
        """
        names = tuple(joints)
        model = UrdfModel.from_file(urdf, package_dirs)
        check_link_count(len(model.links), urdf)
        check_names(names, camera_link, list(model.links), urdf)
        model = model.with_fixed_joints(names, fixed_joints)
        links = [model.root, *(joint.child for joint in model.joints)]
        tree, link_body, frames = _kinematic_tree(model, names)
        by_name = {joint.name: joint for joint in model.joints}
        rows = {name: row for row, name in enumerate(links)}
        order = [rows[name] for name in model.links]
        parts = [model.links[name] for name in model.links]
        return cls(
            joint_names=names,
            lower=np.array([by_name[name].lower for name in names]),
            upper=np.array([by_name[name].upper for name in names]),
            max_speeds=np.array([by_name[name].max_speed for name in names]),
            is_prismatic=np.array([by_name[name].joint_type == "prismatic" for name in names]),
            link_names=tuple(model.links),
            masses=np.array([link.mass for link in parts]),
            centers_of_mass=np.array([link.center_of_mass for link in parts]),
            inertias=np.array([link.inertia for link in parts]),
            meshes=tuple(model.triangles(name) for name in model.links),
            tree=tree,
            link_body=link_body[order],
            link_rotations=np.ascontiguousarray(frames[order, :3, :3]),
            link_translations=np.ascontiguousarray(frames[order, :3, 3]),
            camera_link=list(model.links).index(camera_link),
            T_link_camera=T_link_camera or Pose.identity(),
        )

    def __post_init__(self) -> None:
        arrays = (self.lower, self.upper, self.max_speeds, self.is_prismatic, self.masses,
                  self.centers_of_mass, self.inertias, self.link_body, self.link_rotations,
                  self.link_translations, *self.meshes, *self.tree)  # fmt: skip
        for array in arrays:
            array.flags.writeable = False

    @property
    def n_joints(self) -> int:
        """Number of joints that move."""
        return len(self.joint_names)

    def as_joint_values(self, q: ArrayLike) -> NDArray[np.float64]:
        """Joint values as an array (k, n), or (n,) as given.

        Raises
        ------
        ValueError
            If the shape is another one or a value is not finite; the message names the joint.
        """
        q = np.ascontiguousarray(q, dtype=np.float64)
        if q.ndim not in (1, 2) or q.shape[-1] != self.n_joints:
            raise ValueError(
                f"joint values of shape {q.shape}, expected ({self.n_joints},) or "
                f"(k, {self.n_joints}) for {list(self.joint_names)}"
            )
        if not are_finite(q.reshape(-1)):
            bad = int(np.argwhere(~np.isfinite(q))[0, -1])
            raise ValueError(f"joint {self.joint_names[bad]!r} has a value that is not finite: {q}")
        return q

    def motion_times(self, start: ArrayLike, goals: ArrayLike) -> NDArray[np.float64]:
        """Seconds that straight motions from joint values (n,) to others (k, n) take, shape (k,).

        All joints arrive together, the slowest one at its full speed.
        """
        q0, q1 = self.as_joint_values(start), np.atleast_2d(self.as_joint_values(goals))
        seconds: NDArray[np.float64] = (np.abs(q1 - q0) / self.max_speeds).max(axis=1, initial=0.0)
        return seconds

    def check_limits(self, q: ArrayLike) -> NDArray[np.float64]:
        """As `as_joint_values`; values outside the limits are an error.

        Raises
        ------
        ValueError
            Naming the joint, its value and its limits.
        """
        q = self.as_joint_values(q)
        outside = _first_outside(q.reshape(-1), self.lower, self.upper)
        if outside >= 0:
            at = np.unravel_index(outside, q.shape)
            raise ValueError(
                f"joint {self.joint_names[at[-1]]!r} at {q[at]:.6g} is outside of its limits "
                f"[{self.lower[at[-1]]:.6g}, {self.upper[at[-1]]:.6g}]"
            )
        return q

    def link_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Poses of all links: R (k, L, 3, 3), t (k, L, 3); without k for a single q (n,)."""
        return self._frames(q, self.link_body, self.link_rotations, self.link_translations)

    def camera_poses(self, q: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Poses of the camera: R (k, 3, 3), t (k, 3); without k for a single q (n,)."""
        R, t = self._frames(q, *self.camera_frame)
        return R[..., 0, :, :], t[..., 0, :]

    def point_positions(
        self, q: ArrayLike, body: NDArray[np.int64], points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Positions (k, s, 3) of points (s, 3) fixed to rigid bodies (s,)."""
        q = np.atleast_2d(self.as_joint_values(q))
        out = np.empty((len(q), len(points), 3))
        point_positions(self.tree, q, body, points, out)
        return out

    def jacobian(self, q: ArrayLike) -> NDArray[np.float64]:
        """Jacobian (6, n) of the camera [translation; rotation vector] in the base frame, at q."""
        q = self.as_joint_values(q)
        if q.ndim != 1:
            raise ValueError(f"the Jacobian needs joint values of one pose, got shape {q.shape}")
        body, _, translation = self.camera_frame
        out = np.empty((6, self.n_joints))
        frame_jacobian(self.tree, q, body[0], translation[0], out)
        return out

    @cached_property
    def camera_frame(self) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.float64]]:
        """The camera as a frame: its body (1,), rotation (1, 3, 3) and translation (1, 3) there."""
        link = slice(self.camera_link, self.camera_link + 1)
        R, camera = self.link_rotations[link], self.T_link_camera
        translation = self.link_translations[link] + product(R[0], camera.translation)
        return self.link_body[link], product(R, camera.rotation), translation

    def mounted(
        self,
        base: Pose,
        body: NDArray[np.int64],
        rotation: NDArray[np.float64],
        translation: NDArray[np.float64],
    ) -> PlainTuple:
        """A plain `MountedFrames` of this chain with its root at a base in the world."""
        root = base.arrays
        return (tuple(self.tree), body, rotation, translation, root.rotation, root.translation)

    def _frames(
        self,
        q: ArrayLike,
        body: NDArray[np.int64],
        rotation: NDArray[np.float64],
        translation: NDArray[np.float64],
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        q = self.as_joint_values(q)
        batch = np.atleast_2d(q)
        R, t = np.empty((len(batch), len(body), 3, 3)), np.empty((len(batch), len(body), 3))
        frame_poses(self.tree, batch, body, rotation, translation, R, t)
        return (R, t) if q.ndim == 2 else (R[0], t[0])


@kernel
def _first_outside(
    q: NDArray[np.float64], lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> int:
    """The first of joint values (k n,) that is outside of the limits (n,); -1 if none is."""
    for i in range(len(q)):
        joint = i % len(lower)
        if q[i] < lower[joint] - LIMIT_TOLERANCE or q[i] > upper[joint] + LIMIT_TOLERANCE:
            return i
    return -1


def check_link_count(count: int, urdf: str | Path) -> None:
    """Check that PyBullet can simulate a mount of so many links.

    Raises
    ------
    UrdfError
        With the file, if there are over `MAX_LINKS`.
    """
    if count > MAX_LINKS:
        raise UrdfError(
            f"{urdf} has {count} links with those of a suspension, and a mount can have "
            f"{MAX_LINKS}: leave out frames that carry nothing"
        )


def check_names(
    joints: Sequence[str], camera_link: str, links: Sequence[str], urdf: str | Path
) -> None:
    """Check the joints that are to move, and that the camera is fixed to one of the links.

    Raises
    ------
    ValueError
        If there is no joint, one is named twice, or there is no such link.
    """
    if not joints:
        raise ValueError(f"name at least one joint of {urdf} that moves")
    if len(set(joints)) != len(joints):
        raise ValueError(f"a joint is named twice: {list(joints)}")
    if camera_link not in links:
        raise ValueError(f"{urdf} has no link {camera_link!r} for the camera; it has {links}")


def _kinematic_tree(
    model: UrdfModel, names: tuple[str, ...]
) -> tuple[KinematicTree, NDArray[np.int64], NDArray[np.float64]]:
    """The tree of bodies; per link (root first, then the joints' children) body and frame."""
    rows: list[tuple[int, NDArray[np.float64], UrdfJoint]] = []
    link_frames = {model.root: (0, np.eye(4))}
    for joint in model.joints:
        body, T_body_parent = link_frames[joint.parent]
        T_body_joint = product(T_body_parent, joint.origin)
        if joint.joint_type == "fixed":
            link_frames[joint.child] = (body, T_body_joint)
        else:
            rows.append((body, T_body_joint, joint))
            link_frames[joint.child] = (len(rows), np.eye(4))
    dependences = [row[2].dependence for row in rows]
    frames = [np.eye(4), *(row[1] for row in rows)]
    axis = np.array([np.zeros(3), *(row[2].axis for row in rows)])
    prismatic = np.array([False, *(row[2].joint_type == "prismatic" for row in rows)])
    constant, cosine, sine = rodrigues_terms(
        np.array([frame[:3, :3] for frame in frames]), axis, prismatic
    )
    tree = KinematicTree(
        parent=np.array([0, *(row[0] for row in rows)], dtype=np.int64),
        translation=np.array([frame[:3, 3] for frame in frames]),
        constant=constant,
        cosine=cosine,
        sine=sine,
        axis=axis,
        prismatic=prismatic,
        variable=np.array([0, *(names.index(d.joint) for d in dependences)], dtype=np.int64),
        multiplier=np.array([0.0, *(d.multiplier for d in dependences)]),
        offset=np.array([0.0, *(d.offset for d in dependences)]),
    )
    body_of = np.array([body for body, _ in link_frames.values()], dtype=np.int64)
    return tree, body_of, np.array([frame for _, frame in link_frames.values()])
