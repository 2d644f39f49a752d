"""Kernels that pair the pixels of a scan with earlier scans, and with the known target.

A fiducial's patch is the pixels of a scan that were tracked as the fiducial, or that should see the
target. Each pixel is paired with the surface that an earlier scan measured at its point (projective
association, Blais & Levine 1995), along that surface's normal (Chen & Medioni 1992):

    e = n . (m - p),    sigma^2 = n^T (C_p + C_m) n

with the covariances of Eq. 1. Residuals and their information are summed over each patch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.localization.correction._keyframes import KeyframeArrays, ScanSurfaces
from coopmap_env.localization.correction._known_target import PixelPlanes
from coopmap_env.localization.correction._patches import MIN_VARIANCE, TARGET_SOURCE, PatchSums
from coopmap_env.sensing import PinholeIntrinsics

Array = NDArray[np.float64]

_NO_SOURCE = -2
MIN_NORMAL_COSINE = 0.85
"""Least cosine between the normals of two surfaces that are paired."""
_MIN_DEPTH = 0.1
"""Metres ahead of a camera, below which nothing is paired."""
_GATE_SIGMAS = 3.0
"""Standard deviations beyond which a residual is left out."""


class PatchScan(NamedTuple):
    """The scan whose patches are measured, its camera at an assumed pose."""

    surfaces: ScanSurfaces
    """World frame."""
    labels: NDArray[np.int32]
    """Shape (n,): patch of each pixel, -1 for none."""
    planes: PixelPlanes
    """The target's plane that each pixel should see."""
    optical_axis: Array
    """Shape (3,): world frame."""
    lateral_ratio: float
    """Error across the optical axis (Eq. 1), as a fraction of that along it."""


class PatchSources(NamedTuple):
    """The keyframes that a scan is compared with."""

    keyframes: KeyframeArrays
    slots: NDArray[np.int64]
    """Shape (k,): of the keyframes, in the order in which they are tried."""
    used_pixels: NDArray[np.bool_]
    """Shape (k, n): pixels that have been paired. Each serves once, or its error would count
    twice."""


class AssociationGates(NamedTuple):
    """When a pixel is paired with a surface."""

    max_distance: float
    """Metres between the two points."""
    gate_std: float
    """Metres, added to each pixel's deviation in square, while associations still change."""


@kernel
def associate(
    p: Array,
    normal: Array,
    slot: int,
    keyframes: KeyframeArrays,
    intrinsics: PinholeIntrinsics,
    max_distance: float,
) -> int:
    """Pixel of a keyframe that measured the surface at p (3,), world frame; -1 for none.

    The surface has to lie within a distance in metres, with a similar normal (3,).
    """
    surfaces, R, t = keyframes
    width, height, tan_x, tan_y = intrinsics
    s = slot
    dx, dy, dz = p[0] - t[s, 0], p[1] - t[s, 1], p[2] - t[s, 2]
    x = R[s, 0, 0] * dx + R[s, 1, 0] * dy + R[s, 2, 0] * dz
    if x < _MIN_DEPTH:
        return -1
    y = R[s, 0, 1] * dx + R[s, 1, 1] * dy + R[s, 2, 1] * dz
    z = R[s, 0, 2] * dx + R[s, 1, 2] * dy + R[s, 2, 2] * dz
    column = 0.5 * width * (1.0 - y / (x * tan_x))
    row = 0.5 * height * (1.0 - z / (x * tan_y))
    if column < 0.0 or row < 0.0 or column >= width or row >= height:
        return -1
    m = int(row) * width + int(column)
    if not surfaces.planar[s, m]:
        return -1
    q = surfaces.points[s, m]
    if (q[0] - x) ** 2 + (q[1] - y) ** 2 + (q[2] - z) ** 2 > max_distance * max_distance:
        return -1
    n = surfaces.normals[s, m]
    cosine = 0.0
    for i in range(3):
        in_camera = R[s, 0, i] * normal[0] + R[s, 1, i] * normal[1] + R[s, 2, i] * normal[2]
        cosine += n[i] * in_camera
    return m if cosine >= MIN_NORMAL_COSINE else -1


@kernel
def count_overlap(
    surfaces: ScanSurfaces,
    stride: int,
    slots: NDArray[np.int64],
    keyframes: KeyframeArrays,
    intrinsics: PinholeIntrinsics,
    max_distance: float,
    counts: NDArray[np.int64],
) -> None:
    """Fill how many pixels, one in `stride`, each of the keyframes (k,) measured too.

    The surfaces are in the world frame.
    """
    points, normals = surfaces.points, surfaces.normals
    for i in range(len(slots)):
        counts[i] = 0
        for k in range(0, len(points), stride):
            if surfaces.planar[k]:
                m = associate(points[k], normals[k], slots[i], keyframes, intrinsics, max_distance)
                counts[i] += m >= 0


@kernel
def accumulate_patches(
    scan: PatchScan,
    sources: PatchSources,
    intrinsics: PinholeIntrinsics,
    gates: AssociationGates,
    sums: PatchSums,
) -> None:
    """Add each labelled pixel to its patch; the sums are zero at first."""
    (points, normals, planar, normal_variances, deviations), labels, planes, axis, ratio = scan
    plane_normals, plane_points = planes
    keyframes, slots, used_pixels = sources
    key_surfaces, rotations, translations = keyframes
    n = np.empty(3)
    for k in range(len(labels)):
        patch = labels[k]
        if patch < 0:
            continue
        p = points[k]
        slot, column, m = _NO_SOURCE, TARGET_SOURCE, -1
        on_target = (
            plane_normals[k, 0] != 0.0 or plane_normals[k, 1] != 0.0 or plane_normals[k, 2] != 0.0
        )
        if not on_target and planar[k]:
            for i in range(len(slots)):
                m = associate(p, normals[k], slots[i], keyframes, intrinsics, gates.max_distance)
                if m >= 0 and not used_pixels[i, m]:
                    slot, column = slots[i], i
                    break
        if not on_target and slot == _NO_SOURCE:
            continue
        if on_target:
            e = _target_residual(plane_normals, plane_points, k, p, n)
        else:
            for i in range(3):
                n[i] = normals[k, i]
            e = _keyframe_residual(
                key_surfaces.points, key_surfaces.normals, rotations, translations, slot, m, p, n
            )
        variance = _point_variance(deviations[k], n, axis, ratio)
        normal_variance = 0.0
        if not on_target:
            key_axis = rotations[slot, :, 0]
            variance += _point_variance(key_surfaces.deviations[slot, m], n, key_axis, ratio)
            normal_variance = 0.25 * (normal_variances[k] + key_surfaces.normal_variances[slot, m])
        variance = max(variance, MIN_VARIANCE) + gates.gate_std * gates.gate_std
        if abs(e) > _GATE_SIGMAS * math.sqrt(variance):
            continue
        if not on_target:
            used_pixels[column, m] = True
        _add_pixel(sums, patch, column + 1, n, p, e, 1.0 / variance, normal_variance)


@inlined_kernel
def _target_residual(
    plane_normals: Array, plane_points: Array, k: int, p: Array, n: Array
) -> float:
    """Residual of a point on a pixel's plane, whose normal is written to n."""
    e = 0.0
    for i in range(3):
        n[i] = plane_normals[k, i]
        e += n[i] * (plane_points[k, i] - p[i])
    return e


@inlined_kernel
def _keyframe_residual(
    points: Array,
    normals: Array,
    rotations: Array,
    translations: Array,
    slot: int,
    m: int,
    p: Array,
    n: Array,
) -> float:
    """Residual of a point p from pixel m of a keyframe, along the mean of both normals.

    `n` holds the normal at p, and then the mean. The normals of both scans are noisy: the variance
    of their mean is half as large.
    """
    length = 0.0
    for i in range(3):
        for j in range(3):
            n[i] += rotations[slot, i, j] * normals[slot, m, j]
        length += n[i] * n[i]
    length = math.sqrt(length)
    e = 0.0
    for i in range(3):
        n[i] /= length
        q = translations[slot, i]
        for j in range(3):
            q += rotations[slot, i, j] * points[slot, m, j]
        e += n[i] * (q - p[i])
    return e


@inlined_kernel
def _point_variance(deviation: float, n: Array, axis: Array, lateral_ratio: float) -> float:
    """Variance (Eq. 1) of a point along n (3,), by its deviation along the optical axis (3,)."""
    along = 0.0
    for i in range(3):
        along += n[i] * axis[i]
    along *= along
    return deviation**2 * (along + lateral_ratio * lateral_ratio * (1.0 - along))


@inlined_kernel
def _add_pixel(
    sums: PatchSums,
    patch: int,
    source: int,
    n: Array,
    p: Array,
    e: float,
    w: float,
    normal_variance: float,
) -> None:
    """Add one pixel with weight w to the sums of a patch and source."""
    information, vector, position, weight, normal_variances, n_pixels = sums
    for i in range(3):
        for j in range(3):
            information[patch, source, i, j] += w * n[i] * n[j]
        vector[patch, source, i] += w * e * n[i]
        position[patch, source, i] += w * p[i]
    weight[patch, source] += w
    normal_variances[patch, source] += w * normal_variance
    n_pixels[patch, source] += 1.0
