"""Slow kinematics and collision checks, one pose and one sphere at a time."""

import numpy as np

from coopmap_env.robots import UrdfModel


def rotation_about_axis(axis, angle):
    """Rotation matrix about an axis, by the series of the matrix exponential."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]) * angle
    out, term = np.eye(3), np.eye(3)
    for n in range(1, 60):
        term = term @ K / n
        out = out + term
    return out


def link_poses(model: UrdfModel, values):
    """T (4, 4) of every link in the root's frame, by name; joints without a value are at 0."""
    poses = {model.root: np.eye(4)}
    for joint in model.joints:
        T = np.eye(4)
        value = values.get(joint.name, 0.0)
        if joint.joint_type == "prismatic":
            T[:3, 3] = value * joint.axis
        elif joint.joint_type != "fixed":
            T[:3, :3] = rotation_about_axis(joint.axis, value)
        poses[joint.child] = poses[joint.parent] @ joint.origin @ T
    return poses


def sphere_state(map_, center, radius, level_empty):
    """Worst state of the voxels that a sphere meets: 0 free, 1 unknown, 2 occupied, 3 outside."""
    grid = map_.grid
    low = np.floor(grid.to_cell_units(np.asarray(center) - radius)).astype(int)
    high = np.floor(grid.to_cell_units(np.asarray(center) + radius)).astype(int)
    worst = 0
    for index in np.ndindex(*(high - low + 1)):
        index = low + index
        box = np.array(grid.origin) + index * grid.resolution
        nearest = np.clip(center, box, box + grid.resolution)
        if np.linalg.norm(nearest - center) >= radius:
            continue
        if not grid.contains(index):
            return 3
        cell = grid.flat_index(index)
        state = (
            1 if not map_.sampled_mask[cell] else 2 * int(map_.log_odds_fixed[cell] >= level_empty)
        )
        worst = max(worst, state)
    return worst


def waypoints(q0, q1, n=400):
    """Evenly on a straight joint motion, both ends included."""
    return np.asarray(q0) + np.linspace(0, 1, n)[:, None] * (np.asarray(q1) - q0)


def pose_is_free(vehicle, map_, team, q, settings, level_empty):
    """Whether no sphere at q touches the map, the team or an own link."""
    body = vehicle.body
    centers, radii = vehicle.spheres(q)
    for s in range(body.n_static_spheres, body.n_spheres):
        if sphere_state(map_, centers[s], radii[s] + settings.margin, level_empty):
            return False
        for at, wide in team:
            gap = np.linalg.norm(at - centers[s], axis=1) - wide - radii[s]
            if (gap < settings.team_margin).any():
                return False
    i, j = body.pairs.T
    return bool((np.linalg.norm(centers[i] - centers[j], axis=1) >= radii[i] + radii[j]).all())


def random_joints(chain, rng, n):
    """Joint values (n, joints) within the limits."""
    lower, upper = np.maximum(chain.lower, -3.0), np.minimum(chain.upper, 3.0)
    return rng.uniform(lower, upper, (n, chain.n_joints))
