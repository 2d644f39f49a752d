"""Forward kinematics of a tree of rigid bodies, in batches: kernels."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import sin_cos
from coopmap_env.core.kernels import PlainTuple, borrowing_kernel, kernel
from coopmap_env.core.linear_algebra import product


class KinematicTree(NamedTuple):
    """A kinematic tree: body 0 is fixed; body b is joined to `parent[b]` < b by one moving joint.

    The joint's frame in the parent body is at `translation[b]`; it turns about (or, if
    `prismatic[b]`, slides along) `axis[b]` of that frame by the value
    ``multiplier[b] * q[variable[b]] + offset[b]``. Its rotation in the parent's frame is
    ``constant[b] + cos(value) * cosine[b] + sin(value) * sine[b]``: Rodrigues' formula, sorted.
    """

    parent: NDArray[np.int64]
    translation: NDArray[np.float64]
    constant: NDArray[np.float64]
    cosine: NDArray[np.float64]
    sine: NDArray[np.float64]
    axis: NDArray[np.float64]
    prismatic: NDArray[np.bool_]
    variable: NDArray[np.int64]
    multiplier: NDArray[np.float64]
    offset: NDArray[np.float64]


class BodyPoses(NamedTuple):
    """Buffers for the poses of all bodies of a tree at one q."""

    rotations: NDArray[np.float64]
    """Shape (b, 3, 3); that of the root is given."""
    translations: NDArray[np.float64]
    """Shape (b, 3); that of the root is given."""


def rodrigues_terms(
    rotation: NDArray[np.float64], axis: NDArray[np.float64], prismatic: NDArray[np.bool_]
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """`KinematicTree.constant`, `cosine` and `sine` of joints (b,) with frames and axes in them.

    exp(v [a]x) = a a^T + cos(v) (I - a a^T) + sin(v) [a]x for a unit axis a.
    """
    along = axis[:, :, None] * axis[:, None, :]
    cross = np.zeros_like(along)
    cross[:, [2, 0, 1], [1, 2, 0]] = axis
    cross[:, [1, 2, 0], [2, 0, 1]] = -axis
    turns = ~prismatic[:, None, None]
    constant = np.where(turns, product(rotation, along), rotation)
    return constant, turns * (rotation - product(rotation, along)), turns * product(rotation, cross)


@borrowing_kernel
def matmul_3x3(A: NDArray[np.float64], B: NDArray[np.float64], out: NDArray[np.float64]) -> None:
    """The product A @ B of (3, 3) matrices, written to `out`, which must be neither of them."""
    for i in range(3):
        for j in range(3):
            out[i, j] = A[i, 0] * B[0, j] + A[i, 1] * B[1, j] + A[i, 2] * B[2, j]


@kernel
def rotate(R: NDArray[np.float64], v: NDArray[np.float64]) -> NDArray[np.float64]:
    """The product R @ v of a matrix (3, 3) and a vector (3,)."""
    out = np.empty(3)
    for i in range(3):
        out[i] = R[i, 0] * v[0] + R[i, 1] * v[1] + R[i, 2] * v[2]
    return out


@kernel
def allocate_body_poses(tree: KinematicTree) -> BodyPoses:
    """Buffers for `body_poses`, with the root at the origin."""
    n = len(tree.parent)
    R, t = np.empty((n, 3, 3)), np.empty((n, 3))
    R[0] = np.eye(3)
    t[0] = 0.0
    return BodyPoses(R, t)


@borrowing_kernel
def body_poses(tree: KinematicTree, q: NDArray[np.float64], poses: BodyPoses) -> None:
    """Write the poses of all bodies at one q (n,), from body 1 on; that of the root is given."""
    R, t = poses.rotations, poses.translations
    constant, cosine, sine = tree.constant, tree.cosine, tree.sine
    for body in range(1, len(tree.parent)):
        b = np.uint64(body)  # written out, without views of matrices: twice as fast
        p = np.uint64(tree.parent[b])
        value = tree.multiplier[b] * q[np.uint64(tree.variable[b])] + tree.offset[b]
        x, y, z = tree.translation[b, 0], tree.translation[b, 1], tree.translation[b, 2]
        for i in range(3):
            t[b, i] = t[p, i] + R[p, i, 0] * x + R[p, i, 1] * y + R[p, i, 2] * z
        slides = tree.prismatic[b]
        s, c = (0.0, 0.0) if slides else sin_cos(value)
        for j in range(3):
            x = constant[b, 0, j] + c * cosine[b, 0, j] + s * sine[b, 0, j]
            y = constant[b, 1, j] + c * cosine[b, 1, j] + s * sine[b, 1, j]
            z = constant[b, 2, j] + c * cosine[b, 2, j] + s * sine[b, 2, j]
            for i in range(3):
                R[b, i, j] = R[p, i, 0] * x + R[p, i, 1] * y + R[p, i, 2] * z
        if slides:
            x, y, z = tree.axis[b, 0], tree.axis[b, 1], tree.axis[b, 2]
            for i in range(3):
                t[b, i] += value * (R[b, i, 0] * x + R[b, i, 1] * y + R[b, i, 2] * z)


@kernel
def frame_poses(
    tree: KinematicTree,
    q: NDArray[np.float64],
    body: NDArray[np.int64],
    rotation: NDArray[np.float64],
    translation: NDArray[np.float64],
    R: NDArray[np.float64],
    t: NDArray[np.float64],
) -> None:
    """Write poses of frames fixed to bodies, for a batch q (k, n): R (k, f, 3, 3), t (k, f, 3)."""
    poses = allocate_body_poses(tree)
    Rb, tb = poses.rotations, poses.translations
    for k in range(len(q)):
        body_poses(tree, q[k], poses)
        for f in range(len(body)):
            b, o = body[f], translation[f]
            matmul_3x3(Rb[b], rotation[f], R[k, f])
            for i in range(3):
                t[k, f, i] = tb[b, i] + Rb[b, i, 0] * o[0] + Rb[b, i, 1] * o[1] + Rb[b, i, 2] * o[2]


class MountedFrames(NamedTuple):
    """Frames fixed to the bodies of a tree whose root stands at a base in the world."""

    tree: KinematicTree
    body: NDArray[np.int64]
    """Shape (f,): the body of each frame."""
    rotation: NDArray[np.float64]
    """Shape (f, 3, 3): of the frames in their bodies."""
    translation: NDArray[np.float64]
    """Shape (f, 3)."""
    base_rotation: NDArray[np.float64]
    base_translation: NDArray[np.float64]


@kernel
def mounted_frame_poses(
    frames: PlainTuple, q: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Poses of frames in the world, for a batch q (k, n): R (k, f, 3, 3), t (k, f, 3).

    `frames` is a plain `MountedFrames` with a plain tree.
    """
    tree, body, rotation, translation, base_rotation, base_translation = frames
    R, t = np.empty((len(q), len(body), 3, 3)), np.empty((len(q), len(body), 3))
    frame_poses(KinematicTree(*tree), q, body, rotation, translation, R, t)
    in_base = np.empty((3, 3))
    for k in range(len(q)):
        for f in range(len(body)):
            for i in range(3):
                for j in range(3):
                    in_base[i, j] = R[k, f, i, j]
            matmul_3x3(base_rotation, in_base, R[k, f])
            x, y, z = t[k, f, 0], t[k, f, 1], t[k, f, 2]
            for i in range(3):
                row = base_rotation[i]
                t[k, f, i] = row[0] * x + row[1] * y + row[2] * z + base_translation[i]
    return R, t


@kernel
def point_positions(
    tree: KinematicTree,
    q: NDArray[np.float64],
    body: NDArray[np.int64],
    points: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write positions of points (s, 3) fixed to bodies, for a batch q (k, n): out (k, s, 3)."""
    poses = allocate_body_poses(tree)
    Rb, tb = poses.rotations, poses.translations
    for k in range(len(q)):
        body_poses(tree, q[k], poses)
        for s in range(len(body)):
            b = body[s]
            x, y, z = points[s, 0], points[s, 1], points[s, 2]
            for i in range(3):
                out[k, s, i] = tb[b, i] + Rb[b, i, 0] * x + Rb[b, i, 1] * y + Rb[b, i, 2] * z


class MountedPoints(NamedTuple):
    """Points fixed to the bodies of a tree whose root stands at a base in the world."""

    tree: KinematicTree
    body: NDArray[np.int64]
    """Shape (s,): the body of each point."""
    points: NDArray[np.float64]
    """Shape (s, 3): in their bodies."""
    base_rotation: NDArray[np.float64]
    base_translation: NDArray[np.float64]


@kernel
def mounted_point_positions(points: PlainTuple, q: NDArray[np.float64]) -> NDArray[np.float64]:
    """Positions (k, s, 3) in the world of points fixed to bodies, for a batch q (k, n).

    `points` are plain `MountedPoints` with a plain tree.
    """
    tree, body, local, R, base = points
    out = np.empty((len(q), len(body), 3))
    point_positions(KinematicTree(*tree), q, body, local, out)
    for k in range(len(q)):
        for s in range(len(body)):
            x, y, z = out[k, s, 0], out[k, s, 1], out[k, s, 2]
            for i in range(3):
                out[k, s, i] = x * R[i, 0] + y * R[i, 1] + z * R[i, 2] + base[i]
    return out


@kernel
def frame_jacobian(
    tree: KinematicTree,
    q: NDArray[np.float64],
    body: int,
    translation: NDArray[np.float64],
    out: NDArray[np.float64],
) -> None:
    """Write the Jacobian (6, n) of a frame fixed to `body`: [translation; rotation vector].

    In the root's frame, at one q (n,).
    """
    poses = allocate_body_poses(tree)
    body_poses(tree, q, poses)
    R, t = poses.rotations, poses.translations
    position = t[body] + rotate(R[body], translation)
    out[:] = 0.0
    b = body
    while b > 0:
        # neither rotation about an axis nor translation along it moves the axis
        axis = rotate(R[b], tree.axis[b])
        n, m = tree.variable[b], tree.multiplier[b]
        if tree.prismatic[b]:
            for i in range(3):
                out[i, n] += m * axis[i]
        else:
            arm = position - t[b]
            out[0, n] += m * (axis[1] * arm[2] - axis[2] * arm[1])
            out[1, n] += m * (axis[2] * arm[0] - axis[0] * arm[2])
            out[2, n] += m * (axis[0] * arm[1] - axis[1] * arm[0])
            for i in range(3):
                out[3 + i, n] += m * axis[i]
        b = tree.parent[b]
