"""Verdicts and residuals of a view's pixels, for a hypothesis of the base's pose.

A depth image that is rendered of the target associates each pixel with one of the target's planes
(projective association, Blais & Levine 1995), so a measured point has one plane to lie on:

    r = n . (T p - q),    sigma^2 = n^T R diag(sigma_depth^2, sigma_lateral^2, ...) R^T n

with the range noise of Eq. 1. Its derivative by a displacement [dt, dw] of the base in the target's
frame is [n, (T p - t) x n].
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from coopmap_env.core.elementary import power
from coopmap_env.core.kernels import inlined_kernel, kernel
from coopmap_env.geometry import RigidTransform
from coopmap_env.localization._depth_rendering import DepthImage
from coopmap_env.localization.registration._likelihood_field import DistanceField
from coopmap_env.localization.registration.views import ViewArrays
from coopmap_env.localization.target import TargetPlanes
from coopmap_env.sensing import NoiseParameters

Array = NDArray[np.float64]

AGREES, OCCLUDED, SEEN_THROUGH, UNDECIDED = 1, 2, 3, 0
"""Verdict of a pixel where the target is expected: it sees the target there, sees something in
front of it, sees through it, or none of these; the last for instance at an edge."""


class Thresholds(NamedTuple):
    """When a pixel agrees with its plane, or contradicts it."""

    sigma_floor: float
    """Metres added to sigma in square, for errors of association and pose."""
    gate_sigmas: float
    """Sigmas within which a point agrees with its plane."""
    depth_margin: float
    """Metres by which a range must differ to be in front of the surface, or beyond it."""
    max_range_residual: float
    """Metres along the ray within which a point can agree."""


class ViewEvidence(NamedTuple):
    """Result of one view: what each pixel says, and the normal equations of all."""

    verdicts: NDArray[np.int8]
    """Shape (n,)."""
    H: Array
    """Shape (6, 6): information about the base's displacement."""
    b: Array
    """Shape (6,): information times displacement."""


class SurfacePatches(NamedTuple):
    """Cells of the target's bounding box, and in which of them points lie on the target."""

    seen: NDArray[np.bool_]
    """Shape (nx, ny, nz)."""
    origin: Array
    """Lower corner (3,) of the first cell, metres."""
    size: float
    """Edge of a cell, metres."""


@kernel
def pixel_residuals(
    view: ViewArrays,
    image: DepthImage,
    planes: TargetPlanes,
    T_target_base: RigidTransform,
    noise: NoiseParameters,
    thresholds: Thresholds,
    evidence: ViewEvidence,
    patches: SurfacePatches,
) -> float:
    """Compare a view's pixels with the target: verdicts, normal equations, patches that are seen.

    Returns chi^2: the sum of the agreeing pixels' squared residuals over their variances.
    """
    R, t = T_target_base
    points, hit, ranges, min_ranges, (R_camera, t_camera) = view
    depth, triangle_index = image
    normals, plane_points = planes
    floor, gate, margin, max_residual = thresholds
    verdicts, H, b = evidence
    p, d, axis, camera, J = np.empty(3), np.empty(3), np.empty(3), np.empty(3), np.empty(6)
    chi2 = 0.0
    for i in range(3):
        camera[i] = R[i, 0] * t_camera[0] + R[i, 1] * t_camera[1] + R[i, 2] * t_camera[2] + t[i]
        axis[i] = R[i, 0] * R_camera[0, 0] + R[i, 1] * R_camera[1, 0] + R[i, 2] * R_camera[2, 0]
    for k in range(len(points)):
        verdicts[k] = UNDECIDED
        m = triangle_index[k]
        if m < 0:
            continue
        length = ranges[k]
        if length == 0.0:
            verdicts[k] = OCCLUDED
            continue
        _transform(R_camera, t_camera, points, k, d)
        r, along = 0.0, 0.0
        for i in range(3):
            p[i] = R[i, 0] * d[0] + R[i, 1] * d[1] + R[i, 2] * d[2]  # T p - t
            r += normals[m, i] * (p[i] + t[i] - plane_points[m, i])
            along += normals[m, i] * axis[i]
        # points lie on their rays: range and depth grow alike
        surface = depth[k] * length / points[k, 0]
        variance = _variance(noise, length, along) + floor * floor
        near = abs(length - surface) < max_residual and r * r < gate * gate * variance
        if hit[k] and near:
            verdicts[k] = AGREES
            chi2 += r * r / variance
            # where the ray meets the surface, not where noise puts the point
            for i in range(3):
                d[i] = camera[i] + surface / length * (p[i] + t[i] - camera[i]) - patches.origin[i]
            _mark_patch(patches.seen, d, patches.size)
            _add_residual(H, b, J, p, normals[m], r, variance)
            continue
        tolerance = margin + 3.0 * noise.intrinsic * noise.depth * power(surface, noise.exponent)
        if length < surface - tolerance or (not hit[k] and length < surface + tolerance):
            verdicts[k] = OCCLUDED  # or the ray was not followed as far
        elif min_ranges[k] > surface + tolerance:
            verdicts[k] = SEEN_THROUGH
    return chi2


@inlined_kernel
def _transform(R: Array, t: Array, points: Array, index: int, out: Array) -> None:
    """Write R p + t of one of the points (n, 3)."""
    for i in range(3):
        out[i] = (
            R[i, 0] * points[index, 0]
            + R[i, 1] * points[index, 1]
            + R[i, 2] * points[index, 2]
            + t[i]
        )


@inlined_kernel
def _variance(noise: NoiseParameters, length: float, along: float) -> float:
    """Variance (Eq. 1) of a point along a normal with the cosine `along` to the optical axis."""
    scale = noise.intrinsic * power(length, noise.exponent)
    return (
        scale
        * scale
        * (
            noise.lateral * noise.lateral
            + along * along * (noise.depth * noise.depth - noise.lateral * noise.lateral)
        )
    )


@inlined_kernel
def _mark_patch(seen: NDArray[np.bool_], at: Array, size: float) -> None:
    """Mark the cell (nx, ny, nz) at a position (3,) from the first cell's corner."""
    nx, ny, nz = seen.shape
    x = min(max(int(at[0] / size), 0), nx - 1)
    y = min(max(int(at[1] / size), 0), ny - 1)
    z = min(max(int(at[2] / size), 0), nz - 1)
    seen[x, y, z] = True


@inlined_kernel
def _add_residual(
    H: Array, b: Array, J: Array, p: Array, normal: Array, r: float, variance: float
) -> None:
    """Add one residual to the normal equations; J (6,) is overwritten by its derivative."""
    for i in range(3):
        J[i] = normal[i]
    J[3] = p[1] * normal[2] - p[2] * normal[1]
    J[4] = p[2] * normal[0] - p[0] * normal[2]
    J[5] = p[0] * normal[1] - p[1] * normal[0]
    for i in range(6):
        b[i] -= J[i] * r / variance
        for j in range(6):
            H[i, j] += J[i] * J[j] / variance


@kernel
def count_off_surface(
    view: ViewArrays,
    T_target_base: RigidTransform,
    field: DistanceField,
    low: Array,
    high: Array,
    noise: NoiseParameters,
    tolerance: float,
) -> int:
    """Count a view's points in the box from `low` to `high` (3,), but not on the target.

    The field holds the box. A point is on the target within a tolerance in metres and three sigma
    of Eq. 1.
    """
    R, t = T_target_base
    d, q = np.empty(3), np.empty(3)
    points, hit, _, _, (R_camera, t_camera) = view
    distances, origin, cell = field
    count = 0
    for k in range(len(points)):
        if not hit[k]:
            continue
        _transform(R_camera, t_camera, points, k, d)
        inside = True
        for i in range(3):
            q[i] = R[i, 0] * d[0] + R[i, 1] * d[1] + R[i, 2] * d[2] + t[i]
            inside = inside and low[i] < q[i] < high[i]
        if not inside:
            continue
        x = int((q[0] - origin[0]) / cell)
        y = int((q[1] - origin[1]) / cell)
        z = int((q[2] - origin[2]) / cell)
        square = points[k, 0] ** 2 + points[k, 1] ** 2 + points[k, 2] ** 2
        sigma = noise.intrinsic * noise.depth * power(square, 0.5 * noise.exponent)
        if distances[x, y, z] > tolerance + 3.0 * sigma:
            count += 1
    return count
