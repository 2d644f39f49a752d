"""The joints and links of a mount by the numbers of the physics engine."""

from __future__ import annotations

from dataclasses import dataclass
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.caches import freeze
from coopmap_env.core.linear_algebra import product
from coopmap_env.geometry import Pose
from coopmap_env.robots import Chain, CollisionSpheres, Mount, UrdfModel
from coopmap_env.simulation.physics._sweep_model import SweepModel
from coopmap_env.simulation.physics.client import BulletClient

HOME_CONTACT_DISTANCE = 0.005
"""Metres: links of one vehicle that are this near to each other at home may touch for good."""


DEFAULT_MOTOR_FORCE = 1000.0
"""N or N m: limit of the motors of joints whose URDF states none."""


@dataclass(frozen=True, eq=False)
class JointMap:
    """A mount's URDF by PyBullet's numbers. Link j is moved by joint j; the base is link -1."""

    joints: tuple[int, ...]
    """All joints that can move: heave, roll and pitch, then the mount's, then any other."""
    joint_matrix: NDArray[np.float64]
    """Shape (n_joints, m): joint values are ``joint_matrix @ q + joint_offsets``;
    some may mimic others."""
    joint_offsets: NDArray[np.float64]
    """Shape (n_joints,)."""
    speed_limits: NDArray[np.float64]
    """Shape (n,): limits of the mount's joints, rad/s or m/s."""
    motor_forces: tuple[float, ...]
    """Forces of the motors of all `joints`, N m or N."""
    n_suspension: int
    """How many of the joints are the suspension's: 3, or 0 without one."""
    link_names: tuple[str, ...]
    """Name of link j at j + 1."""
    arm: frozenset[int]
    """The links that the mount's joints move."""
    ignored_pairs: tuple[tuple[int, int], ...]
    """Pairs of a link of the arm and another one whose contacts are ignored: nearly in contact at
    home, or not checked by the robot's own collision spheres. Collision shapes of a URDF are often
    enlarged, and may overlap where the surfaces do not."""
    sweep_model: SweepModel

    @classmethod
    def from_mount(cls, mount: Mount) -> JointMap:
        """Load a mount's URDF and read its joints and links; once per process."""
        chain = mount.chain(with_suspension=mount.suspension is not None)
        cached = _CACHE.setdefault(chain, {})  # equal mounts share their chain
        if mount.home not in cached:
            client = BulletClient()
            try:
                cached[mount.home] = freeze(_read_joint_map(client, mount, chain))
            finally:
                client.close()
        return cached[mount.home]


_CACHE: WeakKeyDictionary[Chain, dict[tuple[float, ...], JointMap]] = WeakKeyDictionary()


def _read_joint_map(client: BulletClient, mount: Mount, chain: Chain) -> JointMap:
    p, k = client.p, {"physicsClientId": client.id}
    body = client.load_mount(mount, Pose.identity())
    infos = [p.getJointInfo(body, j, **k) for j in range(p.getNumJoints(body, **k))]
    names = [info[1].decode() for info in infos]
    chain_joints = [names.index(name) for name in chain.joint_names]
    movable = (p.JOINT_REVOLUTE, p.JOINT_PRISMATIC)
    joints = (
        *chain_joints,
        *(j for j, i in enumerate(infos) if i[2] in movable and j not in chain_joints),
    )
    joint_matrix, joint_offsets = _mimic_matrix(mount, chain, [names[j] for j in joints])

    link_names = (
        p.getBodyInfo(body, **k)[0].decode(), *(info[12].decode() for info in infos)
    )  # fmt: skip
    rigid = dict(zip(chain.link_names, chain.link_body.tolist(), strict=True))
    n_suspension = chain.n_joints - len(mount.joints)
    arm = [j - 1 for j, name in enumerate(link_names) if rigid[name] > n_suspension]
    boxes = {name: _collision_box(client, body, j - 1) for j, name in enumerate(link_names)}
    links = UrdfModel.from_file(mount.urdf, mount.package_dirs).links
    unread = [name for name in link_names if links[name].collisions and boxes[name] is None]
    if unread:
        raise ValueError(f"PyBullet cannot read the collision shapes of {unread} in {mount.urdf}")

    home = product(joint_matrix, np.array([*(0.0,) * n_suspension, *mount.home])) + joint_offsets
    p.resetJointStatesMultiDof(body, list(joints), home[:, None].tolist(), **k)
    near = p.getClosestPoints(body, body, HOME_CONTACT_DISTANCE, **k) or ()
    pairs = {pair for point in near for pair in (point[3:5], point[4:2:-1])}
    checked = CollisionSpheres.from_chain(mount.chain(), mount.home).checked_link_pairs()
    pairs |= {
        (a, b)
        for a in arm
        for b in range(-1, len(link_names) - 1)
        if frozenset((link_names[a + 1], link_names[b + 1])) not in checked
    }
    ignored_pairs = tuple(sorted((a, b) for a, b in pairs if a in arm and b not in arm))
    speed_limits = [i[11] if 0 < i[11] < 100 else 1.0 for i in (infos[j] for j in chain_joints)]
    return JointMap(
        joints=joints,
        joint_matrix=joint_matrix,
        joint_offsets=joint_offsets,
        speed_limits=np.array(speed_limits)[n_suspension:],
        motor_forces=tuple(
            infos[j][10] if infos[j][10] > 0 else DEFAULT_MOTOR_FORCE for j in joints
        ),
        n_suspension=n_suspension,
        link_names=link_names,
        arm=frozenset(arm),
        ignored_pairs=ignored_pairs,
        sweep_model=SweepModel.from_link_boxes(
            chain,
            {name: box for name, box in boxes.items() if box is not None},
            [link_names[j + 1] for j in arm],
            [(link_names[a + 1], link_names[b + 1]) for a, b in ignored_pairs],
        ),
    )


def _mimic_matrix(
    mount: Mount, chain: Chain, names: list[str]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """How the values of joints follow from q: directly, by mimicking another joint, or not.

    PyBullet knows neither mimic joints nor that equal limits fix a joint.
    """
    of = chain.joint_names
    joint_matrix, joint_offsets = np.zeros((len(names), len(of))), np.zeros(len(names))
    model = UrdfModel.from_file(mount.urdf, mount.package_dirs)
    joints = {joint.name: joint for joint in model.joints}
    for row, name in enumerate(names):
        source, multiplier, joint_offsets[row] = joints[name].dependence
        if source in of:
            joint_matrix[row, of.index(source)] = multiplier
    return joint_matrix, joint_offsets


def _collision_box(client: BulletClient, body: int, link: int) -> NDArray[np.float64] | None:
    """Box (2, 3) around a link's collision shape, in the link's frame; None if it has none."""
    p, k = client.p, {"physicsClientId": client.id}
    if not p.getCollisionShapeData(body, link, **k):
        return None
    if link < 0:
        return np.array(p.getAABB(body, link, **k))  # loaded with this frame in the origin
    # the box is aligned with the world's axes: rotate the vehicle until the link's are the same
    p.resetBasePositionAndOrientation(body, [0, 0, 0], [0, 0, 0, 1], **k)
    orientation = p.getLinkState(body, link, **k)[5]
    _, back = p.invertTransform([0, 0, 0], orientation)
    p.resetBasePositionAndOrientation(body, [0, 0, 0], back, **k)
    at = p.getLinkState(body, link, computeForwardKinematics=1, **k)[4]
    box = np.array(p.getAABB(body, link, **k)) - at
    p.resetBasePositionAndOrientation(body, [0, 0, 0], [0, 0, 0, 1], **k)
    return box
