"""Scans compared with each other, pixel by pixel, with poses instead of loops."""

from typing import NamedTuple

import numpy as np

from coopmap_env.geometry import Pose


class PlainScan(NamedTuple):
    pose: Pose
    points: np.ndarray
    normals: np.ndarray
    planar: np.ndarray
    normal_variances: np.ndarray
    deviations: np.ndarray


def pixel_of(point, camera):
    """Number of the pixel through which a point (3,) of the camera frame is visible, or None."""
    if point[0] < 0.1:
        return None
    left, top = (
        np.tan(camera.horizontal_field_of_view / 2),
        np.tan(camera.vertical_field_of_view / 2),
    )
    column = (1 - point[1] / point[0] / left) / 2 * camera.width
    row = (1 - point[2] / point[0] / top) / 2 * camera.height
    if not (0 <= column < camera.width and 0 <= row < camera.height):
        return None
    return int(row) * camera.width + int(column)


def associated_pixel(point, normal, scan, camera, gate, facing):
    """Pixel of an earlier scan that measured the surface at a point of the world, or None."""
    there = scan.pose.inverse()
    m = pixel_of(there.transform(point), camera)
    if m is None or not scan.planar[m]:
        return None
    if np.linalg.norm(scan.points[m] - there.transform(point)) > gate:
        return None
    return m if scan.normals[m] @ (there.rotation @ normal) >= facing else None


def variance_along(n, axis, deviation, lateral):
    """n^T C n of Eq. 1: standard deviation along the optical axis, and a fraction of it across."""
    C = deviation**2 * (lateral**2 * np.eye(3) + (1 - lateral**2) * np.outer(axis, axis))
    return n @ C @ n


def measure_patches(
    scan, earlier_scans, camera, lateral, labels, planes, gates, facing, min_variance, n_labels
):
    """The arrays of `PatchSums`, in their order."""
    information = np.zeros((n_labels, 1 + len(earlier_scans), 3, 3))
    vector, middle = np.zeros((2, n_labels, 1 + len(earlier_scans), 3))
    weight, tilt, count = np.zeros((3, n_labels, 1 + len(earlier_scans)))
    matched = [set() for _ in earlier_scans]
    for k in np.flatnonzero(labels >= 0):
        p, own = scan.pose.transform(scan.points[k]), scan.pose.rotation @ scan.normals[k]
        at, tilted = None, 0.0
        if planes.normals[k].any():
            at, n, there = 0, planes.normals[k], planes.points[k]
        elif scan.planar[k]:
            for s, other in enumerate(earlier_scans):
                m = associated_pixel(p, own, other, camera, gates[0], facing)
                if m is not None and m not in matched[s]:
                    at = 1 + s
                    n = own + other.pose.rotation @ other.normals[m]
                    n = n / np.linalg.norm(n)
                    there = other.pose.transform(other.points[m])
                    break
        if at is None:
            continue
        variance = variance_along(n, scan.pose.rotation[:, 0], scan.deviations[k], lateral)
        if at:
            axis = other.pose.rotation[:, 0]
            variance += variance_along(n, axis, other.deviations[m], lateral)
            tilted = (scan.normal_variances[k] + other.normal_variances[m]) / 4
        variance = max(variance, min_variance) + gates[1] ** 2
        e = n @ (there - p)
        if abs(e) > 3 * np.sqrt(variance):
            continue
        if at:
            matched[at - 1].add(m)
        information[labels[k], at] += np.outer(n, n) / variance
        vector[labels[k], at] += n * e / variance
        middle[labels[k], at] += p / variance
        weight[labels[k], at] += 1 / variance
        tilt[labels[k], at] += tilted / variance
        count[labels[k], at] += 1
    return information, vector, middle, weight, tilt, count
