"""A camera in a world of triangles, without fast code: each ray is tested with each triangle."""

import numpy as np

from coopmap_env.geometry import Pose, rotation_about_z
from coopmap_env.sensing import PointCloud


def box(size, middle, yaw=0.0):
    """Triangles (12, 3, 3) of a box, anticlockwise as seen from outside."""
    faces = [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6)]
    faces += [(0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)]
    units = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    corners = (units * size) @ rotation_about_z(yaw).T + middle
    return corners[np.array(faces)]


def ray_distances(origin, directions, triangles):
    """Distance (n,) along each direction (n, 3) to the first triangle; infinity without one."""
    nearest = np.full(len(directions), np.inf)
    for a, b, c in triangles:
        u, v = b - a, c - a
        p = np.cross(directions, v)
        det = p @ u
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / det
            s = (origin - a) @ p.T * inverse
            q = np.cross(origin - a, u)
            t = directions @ q * inverse
            d = v @ q * inverse
        hits = (np.abs(det) > 1e-12) & (s >= 0) & (t >= 0) & (s + t <= 1) & (d > 0)
        nearest[hits] = np.minimum(nearest[hits], d[hits])
    return nearest


def render_scan(triangles, T_world_camera, camera, noise, rng):
    """Depth scan with the range noise of Eq. 1; rays without a hit end at the far limit."""
    directions = camera.directions
    d = ray_distances(T_world_camera.translation, directions @ T_world_camera.rotation.T, triangles)
    hit = (d >= camera.near) & (d <= camera.far)
    measured = np.where(hit, d, camera.far)
    measured = measured + hit * noise.intrinsic * measured**2 * rng.standard_normal(len(d))
    return PointCloud(directions * measured[:, None], hit)


def look_at_pose(eye, at):
    """Upright camera pose at `eye`, towards a point."""
    x = np.asarray(at, dtype=float) - eye
    x /= np.linalg.norm(x)
    y = np.cross([0.0, 0.0, 1.0], x)
    y /= np.linalg.norm(y)
    return Pose(np.asarray(eye, dtype=float), np.column_stack([x, y, np.cross(x, y)]))
