"""Distances to triangles, covered points and visible points, one by one."""

import itertools
import math

import numpy as np
from plain.triangles import ray_distances


def distance_to_segment(point, a, b):
    """Distance of a point to the segment from a to b."""
    length = np.dot(b - a, b - a)
    fraction = 0.0 if length == 0 else np.clip(np.dot(point - a, b - a) / length, 0, 1)
    return np.linalg.norm(point - a - fraction * (b - a))


def distance_to_triangle(point, triangle):
    """Distance of a point to a triangle (3, 3): over it, or to its nearest edge."""
    a, b, c = triangle
    nearest = min(distance_to_segment(point, *pair) for pair in ((a, b), (b, c), (c, a)))
    edges = np.stack([b - a, c - a], axis=1)
    if np.linalg.matrix_rank(edges) == 2:
        (v, w), *_ = np.linalg.lstsq(edges, point - a, rcond=None)
        if v >= 0 and w >= 0 and v + w <= 1:
            nearest = min(nearest, np.linalg.norm(a + edges @ (v, w) - point))
    return nearest


def nearest_distances(points, triangles):
    """Distance of each point (n, 3) to the nearest of triangles (m, 3, 3)."""
    return np.array([min(distance_to_triangle(p, one) for one in triangles) for p in points])


def covered_mask(map_, points):
    """Which points (n, 3) have an occupied voxel among the 27 around their own."""
    occupied = map_.sampled & (map_.probability > 0.5)
    out = []
    for index in map_.grid.index(points):
        around = [index + step for step in itertools.product((-1, 0, 1), repeat=3)]
        inside = [tuple(one) for one in around if map_.grid.contains(one)]
        out.append(any(occupied[one] for one in inside))
    return np.array(out, dtype=bool)


def is_visible(pose, camera, triangles, point):
    """Whether a point is in a camera's image, in range, and not occluded."""
    x, y, z = pose.inverse().transform(point)
    if x <= 0:
        return False
    across = abs(math.atan2(y, x)) <= camera.horizontal_field_of_view / 2
    upward = abs(math.atan2(z, x)) <= camera.vertical_field_of_view / 2
    ray = point - pose.translation
    distance = np.linalg.norm(ray)
    if not (across and upward and camera.near <= distance <= camera.far):
        return False
    return ray_distances(pose.translation, ray[None] / distance, triangles)[0] > distance - 1e-3
